"""Steps that a script flew, and translations that a pilot flew, by output error."""

from flighttest.diagnose.output_error.answer import OutputErrorAnswer, by_output_error

__all__ = ["OutputErrorAnswer", "by_output_error"]
