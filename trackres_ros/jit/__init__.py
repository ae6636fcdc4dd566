"""Machine code of the kernels: in come functions, out go compiled ones, kept in a sealed cache."""
