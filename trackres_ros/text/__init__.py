"""Numbers and tables as people read them: in come values, out goes text or HTML."""
