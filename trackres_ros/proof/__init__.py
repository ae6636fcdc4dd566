"""The proof: is the diagnosis right on data whose cause is concealed?

The truth here is a second simulator. It shares no code with `model`, `effects` or `diagnosis` (a test holds that), only
the numbers of the vehicle's data sheet.
"""
