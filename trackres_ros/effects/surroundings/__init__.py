"""Effects of site, weather and ground, which are others tomorrow; one file each."""
