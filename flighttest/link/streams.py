"""Message rates that were asked for stay as they were: another ground station may change them, or switch a stream off."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from flighttest.link.ardupilot import ArduPilot

_EVERY_S = 1.0  # over which a rate is measured: five samples of the slowest
_SHARE = 0.5  # of the rate before: what a link loses alone does not take
_LOOKS = 2  # in a row that less than `_SHARE` of all arrives, although it was asked for again: the link carries less
_PATIENCE_S = 10.0  # at lower rates before the ones wanted are tried again; twice as long each time that was too early
_PATIENCE_MAX_S = 80.0
Rates = Mapping[str, float]


class StreamRates:
    """Asks again for each rate that has fallen, and for lower ones where the link carries less than before.

    rates_hz: as wanted; seen_hz: as measured before the flight, where it was; fit: rates wanted and rates that arrive to rates that fit.
    """

    def __init__(
        self, vehicle: ArduPilot, rates_hz: Rates, seen_hz: Rates, fit: Callable[[Rates, Rates], Rates]
    ) -> None:
        self._vehicle = vehicle
        self._wanted_hz, self._seen_hz, self._fit = dict(rates_hz), dict(seen_hz), fit
        self._since_s = vehicle.session.now_s()
        self._counts = dict(vehicle.session.counts)
        self._few = 0  # looks in a row
        self._patience_s = 0.5 * _PATIENCE_S  # doubled each time rates are lowered
        self._lowered_s: float | None = None
        self._ask_for(self._wanted_hz)

    def _ask_for(self, rates_hz: Rates) -> None:
        """From now on these are the rates; the vehicle is not asked here."""
        self._asked_hz = dict(rates_hz)
        self._usual_hz = {name: min(hz, self._seen_hz.get(name, hz)) for name, hz in rates_hz.items()}

    def keep(self) -> str:
        """Ask again for what has fallen below half of its rate since the last look. What was done, '' where nothing was."""
        session = self._vehicle.session
        pace = max(session.clock.pace, 1.0)
        span = session.now_s() - self._since_s
        if 0.0 <= span < _EVERY_S * pace:
            return ""
        counts, before = dict(session.counts), self._counts
        self._since_s, self._counts = session.now_s(), counts
        if span < 0.0 or session.silence_s > 0.5 * _EVERY_S * pace:
            self._few = 0
            return ""  # booted anew, or nothing comes at all: that is the link
        seen = {name: (counts.get(name, 0) - before.get(name, 0)) / span for name in self._usual_hz}
        fallen = [name for name, usual in self._usual_hz.items() if seen[name] < _SHARE * usual]
        text = ""
        few = sum(seen.values()) < _SHARE * sum(self._usual_hz.values())
        self._few = self._few + 1 if few else 0
        if self._few > _LOOKS:
            text = self._lower(seen)
            fallen = list(self._asked_hz) if text else fallen
        elif not fallen and self._lowered_s is not None and session.now_s() - self._lowered_s > self._patience_s * pace:
            self._ask_for(self._wanted_hz)
            self._lowered_s, fallen = None, list(self._asked_hz)
            text = "the link carries what is asked for: the rates before are asked for again"
        for name in fallen:
            self._vehicle.ask_rate(name, self._asked_hz[name])
        return text or (
            f"asked again for {', '.join(fallen)}: somebody else may have changed the rate" if fallen else ""
        )

    def _lower(self, seen_hz: Rates) -> str:
        """Ask for what fits into what arrives; '' where that is what is asked for already."""
        fitting = {name: min(hz, self._asked_hz[name]) for name, hz in self._fit(self._wanted_hz, seen_hz).items()}
        if fitting == self._asked_hz:
            return ""
        if self._lowered_s is None and self._patience_s < _PATIENCE_MAX_S:
            self._patience_s *= 2.0
        self._few, self._lowered_s = 0, self._vehicle.session.now_s()
        self._ask_for(fitting)
        return "the link carries less than before: messages are asked for less often"
