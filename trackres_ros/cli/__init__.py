"""The `trackres` command: one file a command, thin."""
