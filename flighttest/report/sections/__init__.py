"""Data of results to sections of documents, one module per page. Computes no number."""
