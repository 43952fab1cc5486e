"""From segments to parameters worth trusting: problem, solver, covariance, identifiability, validation, model file, export."""
