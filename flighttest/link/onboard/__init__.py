"""What a vehicle keeps aboard, over MAVLink: its logs and its fence."""

from flighttest.link.onboard.fence import Fence, FenceItem
from flighttest.link.onboard.logs import LogDownload, OnboardLog, fetch

__all__ = ["Fence", "FenceItem", "LogDownload", "OnboardLog", "fetch"]
