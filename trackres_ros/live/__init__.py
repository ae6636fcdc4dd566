"""The running application: what arrives, what leaves, and when. Knows no middleware; `ros` and `dds` are its edges."""
