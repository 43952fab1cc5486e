"""Which terms the data asks for: score test, best subsets, cross-validated comparison, what could not be seen."""
