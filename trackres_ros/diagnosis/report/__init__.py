"""A finished diagnosis in, its page, pictures and report.json out."""
