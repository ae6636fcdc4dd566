"""What was computed in; out come objects that print themselves in a terminal and in a notebook, and go to pandas and xarray."""
