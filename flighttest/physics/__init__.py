"""Physics, declared once: parameters, terms and ports, composed into CasADi functions. Must not depend on who is calling."""
