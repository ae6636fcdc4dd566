"""Words of a command line in, text, files and an exit code out: the `trackres` command, one file a command, thin."""
