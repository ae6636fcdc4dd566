"""A recording, or a drive that was never driven, in; results out: replay and simulation."""
