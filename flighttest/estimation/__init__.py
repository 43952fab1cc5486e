"""The statistical model and the estimator: residuals, Jacobian, nuisance parameters profiled out, damped Gauss-Newton, covariance."""
