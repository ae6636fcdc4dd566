"""What a sensor makes of speed or torque; one file each."""
