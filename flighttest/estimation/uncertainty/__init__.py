"""How far estimates may be off: cluster-robust covariance, model discrepancy, distributions."""
