"""Bags and tables: in come files and a topics file, out goes a `Recording` in SI with what was found wrong."""
