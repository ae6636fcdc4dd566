"""Effects that stay with the vehicle wherever it drives, one file each."""
