"""Cut recordings into step responses and windows, and judge which of them can be used.

Must not fit, and must not judge outliers or gusts (identify does).
"""

from flighttest.segments.budget import Stretch, Use, budget
from flighttest.segments.cut import cut
from flighttest.segments.metrics import Metrics, metrics_of
from flighttest.segments.model import Flaw, Segment, SegmentContext

__all__ = ["Flaw", "Metrics", "Segment", "SegmentContext", "Stretch", "Use", "budget", "cut", "metrics_of"]
