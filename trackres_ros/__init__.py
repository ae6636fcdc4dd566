"""Rolling-resistance torque and temperature of rubber tracks, live and from recordings."""

__version__ = "0.1.0"
