"""Physics, declared once: parameters, terms and ports, composed into CasADi functions. Must not know who is calling."""
