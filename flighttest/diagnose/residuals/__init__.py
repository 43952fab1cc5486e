"""What a model leaves: lack of fit, what repeats share, outlying responses, and where it is."""
