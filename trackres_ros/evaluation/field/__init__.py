"""Real recordings in, the page of what was hidden in them and found out."""
