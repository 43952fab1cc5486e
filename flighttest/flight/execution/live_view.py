"""What the operator is shown of a flight while it happens, and the alarms."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

from flighttest.flight.gate import GateLimits, zone_clearance_m
from flighttest.flight.outcome import FlightProgress, OnProgress
from flighttest.flight.state import VehicleState
from flighttest.link.session import Session
from flighttest.mavlink import mode_name

PROGRESS_EVERY_S = 0.25
ALARM_S = 15.0  # for which one is shown
_RATES_OF = ("ATTITUDE", "HIGHRES_IMU", "LOCAL_POSITION_NED")
_RATES_OVER_S = 2.0


class LiveView:
    """The progress of one flight, reported now and then. on_progress: None where it is not reported."""

    def __init__(self, session: Session, on_progress: OnProgress | None) -> None:
        self._session = session
        self._on_progress = on_progress
        self._progress = FlightProgress(0, 0, "", "", "", 0.0, 0.0)
        self._next_s = self._alarm_over_s = -math.inf
        self._alarmed_s: dict[str, float] = {}
        self._counts: tuple[float, dict[str, int]] = (0.0, {})

    def show(self, **changes: Any) -> None:
        """Change what is shown: fields of FlightProgress."""
        self._progress = replace(self._progress, **changes)

    def alarm(self, text: str) -> bool:
        """Show an alarm. Whether it is a new one: not where the same began while one is shown."""
        now, shown_s = self._session.now_s(), ALARM_S * self._pace
        again = now - self._alarmed_s.get(text, -math.inf) < shown_s
        if not again:
            self._alarmed_s[text] = now
        self.show(alarm=text, alarms=self._progress.alarms + (not again))
        self._alarm_over_s = now + shown_s
        return not again

    def report(self, state: VehicleState, gate: GateLimits, *, at_once: bool, stopping: bool, how_to_stop: str) -> None:
        """Report the progress where it is time to, or at once."""
        now = self._session.now_s()
        if self._on_progress is None or (now < self._next_s and not at_once):
            return
        if now > self._alarm_over_s:
            self.show(alarm="")
        self._next_s = now + PROGRESS_EVERY_S * self._pace
        clearance, place, speed = math.nan, None, math.nan
        # What is too old for the gate is not shown either: a wall moved nearer by a velocity that was, for as long as the link was gone.
        known = state.position_ok and state.position_age_s <= gate.position_age_max_s
        if known and state.position_m is not None and state.velocity_m_s is not None:
            clearance = zone_clearance_m(state, gate)
            here = gate.zone.from_world([state.position_m[0], state.position_m[1], 0.0])
            place, speed = (float(here[0]), float(here[1])), math.hypot(*state.velocity_m_s)
        self._on_progress(
            replace(
                self._progress,
                t_s=now,
                zone_margin_m=clearance,
                place_m=place,
                zone_m=(gate.zone.x_m, gate.zone.y_m),
                height_m=state.height_m if state.height_m is not None else math.nan,
                speed_m_s=speed,
                voltage_v=state.voltage_v if state.voltage_v is not None else math.nan,
                voltage_min_v=gate.limits.voltage_min_v,
                link_loss=self._session.port.loss_share,
                uplink_silence_s=state.uplink_silence_s,
                silence_s=state.silence_s,
                rates_hz=self._rates(now),
                mode=mode_name(state.mode),
                stopping=stopping,
                how_to_stop=how_to_stop,
            )
        )

    @property
    def _pace(self) -> float:
        return max(self._session.clock.pace, 1.0)

    def _rates(self, now: float) -> dict[str, float]:
        since, counts = self._counts
        span = now - since
        received = self._session.counts
        rates = {name: (received.get(name, 0) - counts.get(name, 0)) / span for name in _RATES_OF if span > 0}
        if span > _RATES_OVER_S:
            self._counts = (now, dict(received))
        return rates
