"""May an estimate be trusted: identifiability, heterogeneity, local optima, closed-loop bias, residuals, bootstrap."""
