"""Recordings in, evenly spaced sessions out, or a line that says what is wrong with units, clocks and torque."""
