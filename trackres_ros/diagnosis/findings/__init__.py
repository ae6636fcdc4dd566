"""A chosen fit in, statements out: where, how much, how sure, and what to drive next."""
