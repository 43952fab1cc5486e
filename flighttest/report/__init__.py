"""Results to a `Document` (pure data), and a document to HTML, terminal or JSON. Computes no number."""
