"""Message rates fitted to what a link carries: towards the least that a flight needs where it does not carry all of them."""

from __future__ import annotations

from collections.abc import Mapping

from flighttest.flight.preparation.preflight import BLIND_RATES_HZ, RATE_SHARE, RATES_HZ
from flighttest.link.ardupilot import ArduPilot
from flighttest.link.transport import full_url
from flighttest.plan import Plan

# Bytes of a message on the wire: MAVLink 2's 12 and the payload as ArduCopter fills it (trailing zeros are not sent).
_BYTES: dict[str, int] = {
    "HEARTBEAT": 21, "ATTITUDE": 40, "HIGHRES_IMU": 74, "RAW_IMU": 38, "LOCAL_POSITION_NED": 40, "ATTITUDE_TARGET": 49,
    "BATTERY_STATUS": 50, "GLOBAL_POSITION_INT": 40, "VFR_HUD": 32, "SERVO_OUTPUT_RAW": 33, "EKF_STATUS_REPORT": 38,
    "RC_CHANNELS": 54, "SCALED_PRESSURE": 28, "DISTANCE_SENSOR": 40, "SYS_STATUS": 43,
}  # fmt: skip
# The least that preflight and the gate's greatest ages allow, with a twentieth of the frames lost, Hz.
_LEAST_HZ: dict[str, float] = {
    "HEARTBEAT": 5.0, "ATTITUDE": 45.0, "HIGHRES_IMU": 25.0, "LOCAL_POSITION_NED": 10.0, "ATTITUDE_TARGET": 5.0,
    "BATTERY_STATUS": 2.0, "GLOBAL_POSITION_INT": 1.0, "VFR_HUD": 1.0, "SERVO_OUTPUT_RAW": 1.0, "EKF_STATUS_REPORT": 2.0,
    "RC_CHANNELS": 2.0, "SCALED_PRESSURE": 5.0, "DISTANCE_SENSOR": 5.0, "SYS_STATUS": 2.0,
}  # fmt: skip
_STREAMS_SHARE = 0.85  # of a link; answers, texts and TIMESYNC need the rest
_BITS_PER_BYTE = 10  # on a serial line: start and stop bit


def bytes_s(rates_hz: Mapping[str, float]) -> float:
    """What rates take of a link, bytes per second."""
    return sum(_BYTES[name] * rate for name, rate in rates_hz.items())


def declared_bytes_s(url: str) -> float | None:
    """What a link carries by its URL, bytes per second; None where the URL has no baud rate."""
    kind, _, rest = full_url(url).partition(":")
    baud = rest.rpartition(":")[2]
    return int(baud) / _BITS_PER_BYTE if kind == "serial" and baud.isdigit() else None


def fitted(wanted_hz: Mapping[str, float], capacity_bytes_s: float | None) -> dict[str, float]:
    """The rates wanted, Hz, all moved towards the least ones by one share so that they fit; None fits everything."""
    least = {name: min(rate, _LEAST_HZ[name]) for name, rate in wanted_hz.items()}
    full, floor = bytes_s(wanted_hz), bytes_s(least)
    if capacity_bytes_s is None or full <= floor:
        return dict(wanted_hz)
    share = min(max((_STREAMS_SHARE * capacity_bytes_s - floor) / (full - floor), 0.0), 1.0)
    return {name: round(least[name] + share * (rate - least[name]), 1) for name, rate in wanted_hz.items()}


def fitted_to_seen(wanted_hz: Mapping[str, float], seen_hz: Mapping[str, float]) -> dict[str, float]:
    """The rates wanted, Hz, fitted to a link that carries what arrives of them and no more."""
    return fitted(wanted_hz, bytes_s(seen_hz) / _STREAMS_SHARE)


class Telemetry:
    """The streams of one flight. rates_hz: as asked for now; notes: sentences for the record."""

    def __init__(self, vehicle: ArduPilot, plan: Plan, url: str) -> None:
        self._vehicle = vehicle
        self._wanted_hz = RATES_HZ if plan.reset.by == "guided" else RATES_HZ | BLIND_RATES_HZ
        self._capacity = declared_bytes_s(url)
        self._refused: set[str] = set()
        self.notes: list[str] = []
        self.rates_hz: dict[str, float] = {}

    def ask(self) -> None:
        """Ask for what fits; where the vehicle has no HIGHRES_IMU, for RAW_IMU in its place."""
        self.rates_hz = fitted(self._wanted_hz, self._capacity)
        if self.rates_hz != self._wanted_hz:
            asked = ", ".join(f"{name} {self.rates_hz[name]:g}" for name in ("ATTITUDE", "HIGHRES_IMU"))
            self.notes.append(
                f"the link carries {self._capacity or 0.0:.0f} bytes/s: messages are asked for less often ({asked} Hz)"
            )
        refused = self._vehicle.set_rates({n: r for n, r in self.rates_hz.items() if n not in self._refused})
        self.notes += [f"{name} was refused: {why}" for name, why in refused.items()]
        self._refused |= refused.keys()
        if "HIGHRES_IMU" in self._refused:
            self._vehicle.set_rates({"RAW_IMU": self.rates_hz["HIGHRES_IMU"]})

    @property
    def granted_hz(self) -> dict[str, float]:
        """The rates that were asked for and not refused, Hz."""
        return {name: rate for name, rate in self.rates_hz.items() if name not in self._refused}

    def measure(self, real_time: bool) -> dict[str, float]:
        """Rates as they arrive, Hz. Where a link drops much of them in real time, what arrives is what it carries: asked again, once."""
        names = [*self.rates_hz, "RAW_IMU"]
        found = self._vehicle.measure_rates(names)
        asked = self.granted_hz
        seen = {n: found[n] for n in asked}
        if not real_time or self._capacity is not None or bytes_s(seen) >= RATE_SHARE * bytes_s(asked):
            return found
        self._capacity = bytes_s(seen) / _STREAMS_SHARE
        self.ask()
        return self._vehicle.measure_rates(names)
