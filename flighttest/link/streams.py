"""Message rates that were asked for stay as they were: another ground station may change them, or switch a stream off."""

from __future__ import annotations

from collections.abc import Mapping

from flighttest.link.ardupilot import ArduPilot

_EVERY_S = 1.0  # over which a rate is measured: five samples of the slowest
_SHARE = 0.5  # of the rate before: what a link loses alone does not take


class Streams:
    """Asks again for each rate that has fallen. rates_hz: as asked for; seen_hz: as measured before the flight, where it was."""

    def __init__(self, vehicle: ArduPilot, rates_hz: Mapping[str, float], seen_hz: Mapping[str, float]) -> None:
        self._vehicle = vehicle
        self._asked_hz = dict(rates_hz)
        self._usual_hz = {name: min(hz, seen_hz.get(name, hz)) for name, hz in rates_hz.items()}
        self._since_s = vehicle.session.now_s()
        self._counts = dict(vehicle.session.counts)

    def keep(self) -> list[str]:
        """Ask again for what has fallen below half of its rate since the last look, and return its names."""
        session = self._vehicle.session
        span = session.now_s() - self._since_s
        if 0.0 <= span < _EVERY_S * max(session.clock.pace, 1.0):
            return []
        counts, before = dict(session.counts), self._counts
        self._since_s, self._counts = session.now_s(), counts
        if span < 0.0 or session.silence_s > 0.5 * _EVERY_S * max(session.clock.pace, 1.0):
            return []  # booted anew, or nothing comes at all: that is the link
        fallen = [
            name
            for name, usual in self._usual_hz.items()
            if counts.get(name, 0) - before.get(name, 0) < _SHARE * usual * span
        ]
        for name in fallen:
            self._vehicle.ask_rate(name, self._asked_hz[name])
        return fallen
