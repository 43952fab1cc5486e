"""A fit looked at response by response: measured beside simulated, correlation of the residuals, frequency responses and coherence."""
