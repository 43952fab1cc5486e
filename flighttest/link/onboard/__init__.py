"""Logs that a vehicle keeps aboard, over MAVLink."""

from flighttest.link.onboard.logs import LogDownload, OnboardLog, fetch, mavsdk_url

__all__ = ["LogDownload", "OnboardLog", "fetch", "mavsdk_url"]
