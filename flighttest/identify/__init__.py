"""From segments to parameters worth trusting: data selection, start values, identifiability, validation, model file, export."""
