"""The live estimate: guards, one pure step, snapshot and resume. `estimator.Estimator` is where to begin."""
