"""Files that are read whole, our own and the user's: paths in, bounded and checked contents out."""
