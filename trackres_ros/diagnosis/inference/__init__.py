"""Sessions and a base in, a fit out: values, how sure they are, and the noise."""
