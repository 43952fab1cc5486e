"""A `Document` to HTML, terminal, SVG, plotly or JSON. Computes no number."""
