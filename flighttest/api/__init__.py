"""The public interface: verbs, what they answer, the catalogue. Use it as `import flighttest as ft`.

Calls the same steps of `pipeline` as the command line; must not compute, parse arguments or print.
"""
