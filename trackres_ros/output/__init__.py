"""Results: in come rows of the estimator, out go topics, bags, tables and pictures."""
