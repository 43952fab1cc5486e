"""The only place that holds the order: fly, cut, fit, diagnose, check validity, report. Prints nothing."""
