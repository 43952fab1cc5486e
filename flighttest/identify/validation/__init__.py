"""A model against flights that were not fitted, beside its ablations; the paper's own procedure as a cross-check."""
