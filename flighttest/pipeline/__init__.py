"""The only place that knows the order: fly, cut, fit, diagnose, check currency, report. Prints nothing."""
