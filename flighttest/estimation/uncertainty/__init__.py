"""How far estimates may be off: cluster-robust covariance, colored residuals, closed-loop bias, model discrepancy, distributions."""
