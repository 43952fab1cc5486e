"""model.yaml: written, read, compared, carried over as a prior, exported."""
