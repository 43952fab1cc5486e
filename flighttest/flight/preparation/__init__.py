"""Before take-off: preflight, parameters set for the flight, message rates, where the zone lies."""
