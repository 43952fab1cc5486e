"""The only place that knows the order: fly, cut, fit, diagnose, check validity, report. Prints nothing."""
