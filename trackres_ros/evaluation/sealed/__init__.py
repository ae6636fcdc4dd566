"""Sealed drives of a second simulator in, scores out. The truth shares no code with `model`, `effects` or `diagnosis`."""
