"""Plain tables, with or without a column map, to a recording."""
