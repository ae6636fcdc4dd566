"""Sessions and values in, expected torque and temperature out: the models that are fitted."""
