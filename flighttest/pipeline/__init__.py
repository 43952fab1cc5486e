"""The only place that knows the order of the house: fly, cut, fit, diagnose, check currency, report. Prints nothing."""
