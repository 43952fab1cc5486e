"""The model integrated over many responses at once with exact derivatives, by CasADi or in C."""
