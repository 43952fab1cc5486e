"""A stream of recorded MAVLink messages to channels on the vehicle's clock: what both the recorder and the tlog importer use."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from operator import attrgetter
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from flighttest.errors import RecordingError
from flighttest.mavlink.accepted import in_force, taken, throttle_of
from flighttest.mavlink.clock import ClockEstimate, estimate_clock
from flighttest.mavlink.dialect import COMPONENT_AUTOPILOT, board_id, dialect, firmware_version, is_armed, is_vehicle
from flighttest.mavlink.marks import Text, markers_from_texts
from flighttest.mavlink.modes import mode_name
from flighttest.mavlink.stamps import HALF_MS, in_lock_step, rounded_off, stamped_rules, stamps, times_of
from flighttest.mavlink.targets import REFERENCE_FIELDS, reference_columns
from flighttest.mavlink.telemetry import NO_BATTERY, RULES, Rule
from flighttest.recording import Marker, Series

FloatArray = NDArray[np.float64]
_Raw: TypeAlias = dict[str, dict[str, FloatArray]]
SenderId = tuple[int, int]
"""System and component id of a sender: cameras, companion computers and autopilots share a vehicle's system id."""

_GROUPS = tuple(dict.fromkeys(rule.group for rule in RULES))
_REBOOT_S = 1.0  # the vehicle's time going back by more than this is a reboot, by less a reordered datagram
_STAMP_TRUST_S = 30.0
_STAMP_S = 1e-3  # the vehicle's ms and the sender's are rounded, each by itself
_STAMP_WANDER_S = 0.01  # TIMESYNC and a sender that stamps by the clock differ by less over a flight, unless the clock is a simulator's
_STAMP_AGREEMENT_S = 0.2  # a sender whose stamps stay this near to the vehicle's time stamps on the vehicle's clock


@dataclass(frozen=True)
class Decoded:
    """What a message stream holds. See `Recording` and `Provenance` for the meaning of the fields.

    series: group to Series on the vehicle's clock. origin: (latitude, longitude) deg of the local frame, or None. counts: message
    name to number received. vehicle_system: the system id that was taken as the vehicle; autopilot, vehicle_type: what its HEARTBEAT calls
    itself; board: its own number, '' where it was not recorded.
    """

    series: Mapping[str, Series]
    markers: tuple[Marker, ...]
    clock: ClockEstimate
    parameters: Mapping[str, float]
    firmware: str
    losses: tuple[str, ...]
    derived: Mapping[str, str]
    reference_clock: str
    vehicle_system: int
    autopilot: int = dialect.MAV_AUTOPILOT_INVALID
    vehicle_type: int = dialect.MAV_TYPE_GENERIC
    origin: tuple[float, float] | None = None
    counts: Mapping[str, int] = field(default_factory=dict)
    board: str = ""


class _Rows:
    """Ground times and field values of one message type of one system."""

    def __init__(self, fields: tuple[str, ...]) -> None:
        self.fields = fields
        self.get: Callable[[Any], Any] = attrgetter(*fields)
        self.ground_s: Sequence[float] | FloatArray = []
        self.order: Sequence[int] | NDArray[np.int64] = []
        self.values: list[Any] = []
        self.columns: dict[str, FloatArray] | None = None

    def add(self, t_s: float, order: int, message: Any) -> None:
        assert isinstance(self.ground_s, list)  # rows that came as columns are complete
        assert isinstance(self.order, list)
        self.ground_s.append(t_s)
        self.order.append(order)
        self.values.append(self.get(message))

    def raw(self) -> dict[str, FloatArray]:
        if self.columns is not None:
            return self.columns
        columns = zip(*self.values, strict=True) if len(self.fields) > 1 else [self.values]
        return {name: np.asarray(column, dtype=float) for name, column in zip(self.fields, columns, strict=True)}


def _fields_of(message: str) -> tuple[str, ...]:
    wanted = {f for rule in RULES if rule.message == message for f in rule.fields}
    wanted |= {rule.stamp for rule in RULES if rule.message == message and rule.stamp}
    return tuple(sorted(wanted))


_FIELDS: dict[str, tuple[str, ...]] = {rule.message: _fields_of(rule.message) for rule in RULES}
_FIELDS["SET_ATTITUDE_TARGET"] = ("time_boot_ms", "target_system", *REFERENCE_FIELDS)
_FIELDS["HEARTBEAT"] = ("type", "autopilot", "base_mode", "custom_mode")
_FIELDS["ATTITUDE_TARGET"] = (*_FIELDS["ATTITUDE_TARGET"], "thrust")
_FIELDS["VFR_HUD"] = (*_FIELDS["VFR_HUD"], "throttle")

WANTED: frozenset[str] = frozenset(_FIELDS) | {
    "STATUSTEXT", "TIMESYNC", "PARAM_VALUE", "AUTOPILOT_VERSION", "GPS_GLOBAL_ORIGIN", "HOME_POSITION",
}  # fmt: skip
"""The messages `decode_stream` reads; an importer may skip the rest."""


class StreamDecoder:
    """One pass over a stream: `add` every message in the order received or sent, then `result`."""

    def __init__(self) -> None:
        self.rows: dict[tuple[SenderId, str], _Rows] = {}
        self.autopilots: dict[SenderId, tuple[int, int]] = {}  # HEARTBEATs that showed armed, and all
        self.texts: list[Text] = []
        self.parameters: dict[SenderId, list[tuple[float, str, float]]] = {}
        self.firmware: dict[SenderId, str] = {}
        self.boards: dict[SenderId, str] = {}
        self.origins: dict[SenderId, tuple[float, float]] = {}
        self.asked: dict[int, float] = {}
        self.round_trips: dict[SenderId, list[tuple[float, float, float]]] = {}
        self._count = 0

    def add(self, t_s: float, message: Any, order: int | None = None) -> None:
        """Take in one message with its ground time, s, and its position in the stream (counted where None)."""
        kind = message.get_type()
        self._count += 1
        if kind not in WANTED:
            return
        source = (message.get_srcSystem(), message.get_srcComponent())
        fields = _FIELDS.get(kind)
        if fields is not None:
            if kind == "HEARTBEAT":
                if not is_vehicle(message):
                    return
                armed, beats = self.autopilots.get(source, (0, 0))
                self.autopilots[source] = armed + is_armed(message), beats + 1
            rows = self.rows.get((source, kind))
            if rows is None:
                rows = self.rows[source, kind] = _Rows(fields)
            rows.add(t_s, self._count if order is None else order, message)
        elif kind == "STATUSTEXT":
            self.texts.append(
                Text(t_s, source[0], int(message.severity), message.text, int(message.id), int(message.chunk_seq))
            )
        elif kind == "TIMESYNC":
            self._timesync(t_s, source, message)
        elif kind == "PARAM_VALUE":
            self.parameters.setdefault(source, []).append((t_s, message.param_id, float(message.param_value)))
        elif kind == "AUTOPILOT_VERSION":
            self.firmware[source] = firmware_version(message)
            self.boards[source] = board_id(message)
        elif message.latitude or message.longitude:
            self.origins.setdefault(source, (message.latitude * 1e-7, message.longitude * 1e-7))

    def add_columns(
        self,
        source: SenderId,
        kind: str,
        ground_s: FloatArray,
        order: NDArray[np.int64],
        columns: Mapping[str, NDArray[Any]],
    ) -> None:
        """Take in all messages of one numeric type of one sender at once: ground times (n,), s, positions in the stream (n,), and
        fields (n,) or (n, k)."""
        rows = self.rows[source, kind] = _Rows(_FIELDS[kind])
        rows.ground_s = ground_s
        rows.order = order
        rows.columns = {name: np.asarray(columns[name], dtype=float) for name in rows.fields}

    def _timesync(self, t_s: float, source: SenderId, message: Any) -> None:
        if message.tc1 == 0:
            self.asked[message.ts1] = t_s
        elif message.ts1 in self.asked:
            trip = (self.asked[message.ts1], message.tc1 * 1e-9, t_s)  # a companion computer may answer as well
            self.round_trips.setdefault(source, []).append(trip)

    def result(self, vehicle_system: int | None = None) -> Decoded:
        """What was taken in so far; see `decode_stream`."""
        if vehicle_system is None and not self.autopilots:
            raise RecordingError("no autopilot HEARTBEAT in the MAVLink stream", "is this the log of a vehicle's link?")
        candidates = [s for s in self.autopilots if vehicle_system in (None, s[0])]
        unknown = (vehicle_system or 0, COMPONENT_AUTOPILOT)
        return _assemble(self, max(candidates, key=lambda s: self.autopilots[s], default=unknown))


def decode_stream(stream: Iterable[tuple[float, Any]], *, vehicle_system: int | None = None) -> Decoded:
    """Decode messages in the order received or sent.

    stream: (ground time s, pymavlink message), both directions. vehicle_system: the vehicle's system id; None takes the one that was
    armed the longest, else the one with most autopilot heartbeats. RecordingError when no vehicle, or no message with the vehicle's time,
    is in the stream.
    """
    collected = StreamDecoder()
    for t_s, message in stream:
        collected.add(t_s, message)
    return collected.result(vehicle_system)


def _assemble(collected: StreamDecoder, source: SenderId) -> Decoded:
    system = source[0]
    losses: list[str] = []
    raw, ground, order, span = _of_one_boot(collected, source, losses)
    lost_s = rounded_off(raw)
    stamped = [(ground[r.message], stamps(r, raw[r.message], lost_s)) for r in stamped_rules(raw)]
    if not stamped and source not in collected.round_trips:
        raise RecordingError(
            "no message carries the vehicle's time",
            "record ATTITUDE, HIGHRES_IMU or LOCAL_POSITION_NED with the flight",
        )
    trips = [t for t in collected.round_trips.get(source, []) if span[0] <= t[0] <= span[1]]
    came_s = np.concatenate([np.empty(0), *(g for g, _ in stamped)])
    made_s = np.concatenate([np.empty(0), *(v for _, v in stamped)])
    clock = estimate_clock(came_s, made_s, trips)
    reference, reference_clock, clock = _reference(collected, source, span, clock, (came_s, made_s), losses)
    times = times_of(raw, ground, order, clock, lost_s)
    series, derived = _series(raw, times, losses)
    if "battery" not in series and not raw.keys().isdisjoint(("SYS_STATUS", "BATTERY_STATUS")):
        losses.append(NO_BATTERY)
    beats = raw.get("HEARTBEAT", {})
    armed = _armed(beats)
    last_armed_s = float(np.max(ground["HEARTBEAT"][armed])) if armed.any() else np.inf
    parameters = in_force(collected.parameters.get(source, []), last_armed_s)
    autopilot = next((int(a) for a in beats.get("autopilot", ())), dialect.MAV_AUTOPILOT_INVALID)
    own = (times["ATTITUDE_TARGET"], raw["ATTITUDE_TARGET"]["thrust"]) if "ATTITUDE_TARGET" in raw else None
    if reference is not None and autopilot == dialect.MAV_AUTOPILOT_ARDUPILOTMEGA:
        reference = taken(reference, times["HEARTBEAT"], beats["custom_mode"], losses)
        reference = throttle_of(reference, own, parameters, derived, losses) if reference is not None else None
    if reference is not None:
        series["reference"] = reference
    elif own is not None:
        series["reference"] = _ordered(own[0], {"throttle": own[1]}, "ATTITUDE_TARGET", losses)
        derived["throttle"] = "the vehicle's ATTITUDE_TARGET.thrust: no SET_ATTITUDE_TARGET was recorded"
        reference_clock = "vehicle"
    elif "VFR_HUD" in raw:
        throttle = raw["VFR_HUD"]["throttle"] * 1e-2
        series["reference"] = _ordered(times["VFR_HUD"], {"throttle": throttle}, "VFR_HUD", losses)
        derived["throttle"] = "VFR_HUD.throttle, after tilt boost, in whole percents: no ATTITUDE_TARGET was recorded"
        reference_clock = "ground"  # neither it nor NAV_CONTROLLER_OUTPUT carries a stamp: when they arrived is known
    markers = markers_from_texts([t for t in collected.texts if span[0] <= t.ground_s <= span[1]], system, clock)
    if beats:
        series["state"] = _ordered(
            times["HEARTBEAT"], {"mode": beats["custom_mode"], "armed": armed.astype(float)}, "HEARTBEAT", losses
        )
        markers += mode_markers(series["state"])
    return Decoded(
        series=series,
        markers=tuple(sorted(markers, key=lambda m: m.t_s)),
        clock=clock,
        parameters=parameters,
        firmware=collected.firmware.get(source, ""),
        board=collected.boards.get(source, ""),
        losses=tuple(losses),
        derived=derived,
        reference_clock=reference_clock,
        vehicle_system=system,
        autopilot=autopilot,
        vehicle_type=next((int(a) for a in beats.get("type", ())), dialect.MAV_TYPE_GENERIC),
        origin=collected.origins.get(source),
        counts={kind: int(times.size) for kind, times in ground.items()},
    )


def _of_one_boot(
    collected: StreamDecoder, source: SenderId, losses: list[str]
) -> tuple[_Raw, dict[str, FloatArray], dict[str, NDArray[np.int64]], tuple[float, float]]:
    """What a sender sent in its longest run: fields, ground times (s) and positions in the stream by message; and from when to when."""
    raw = {kind: rows.raw() for (s, kind), rows in collected.rows.items() if s == source}
    ground = {kind: np.asarray(collected.rows[source, kind].ground_s) for kind in raw}
    order = {kind: np.asarray(collected.rows[source, kind].order) for kind in raw}
    span = _last_boot(raw, ground, losses)
    for kind in raw:
        inside = (ground[kind] >= span[0]) & (ground[kind] <= span[1])
        if not inside.all():
            raw[kind] = {name: values[inside] for name, values in raw[kind].items()}
            ground[kind], order[kind] = ground[kind][inside], order[kind][inside]
    return raw, ground, order, span


def _armed(beats: Mapping[str, FloatArray]) -> NDArray[np.bool_]:
    """By HEARTBEAT's fields (n,), whether each shows armed."""
    if not beats:
        return np.zeros(0, dtype=bool)
    return np.asarray(beats["base_mode"].astype(int) & int(dialect.MAV_MODE_FLAG_SAFETY_ARMED), dtype=bool)


def _last_boot(
    raw: Mapping[str, dict[str, FloatArray]], ground: Mapping[str, FloatArray], losses: list[str]
) -> tuple[float, float]:
    """The span of ground time, s, of the longest time the vehicle ran without a reboot."""
    best: Rule | None = max(stamped_rules(raw), key=lambda r: ground[r.message].size, default=None)
    if best is None:
        return -np.inf, np.inf
    v = stamps(best, raw[best.message], 0.0)
    back = np.flatnonzero(np.diff(v) < -_REBOOT_S) + 1
    if back.size == 0:
        return -np.inf, np.inf
    edges = np.concatenate([[0], back, [v.size]])
    longest = int(np.argmax(np.diff(edges)))
    start, end = int(edges[longest]), int(edges[longest + 1])
    losses.append(f"the vehicle's clock restarted {back.size} times (a reboot); only its longest run was read")
    g = ground[best.message]
    return float(g[start]), float(g[end - 1])


def _series(
    raw: Mapping[str, dict[str, FloatArray]], times: Mapping[str, FloatArray], losses: list[str]
) -> tuple[dict[str, Series], dict[str, str]]:
    series: dict[str, Series] = {}
    derived: dict[str, str] = {}
    for group in _GROUPS:
        found: list[tuple[Rule, Series]] = []
        for rule in (r for r in RULES if r.group == group and r.message in raw):
            fields = raw[rule.message]
            t_s = times[rule.message]
            if rule.keep is not None:
                kept = rule.keep(fields)
                fields, t_s = {n: v[kept] for n, v in fields.items()}, t_s[kept]
            if t_s.size:
                found.append((rule, _ordered(t_s, rule.convert(fields), rule.message, losses)))
        # A better message that came at a trickle is not better: it must have at least a fifth of the samples of the densest.
        most = max((len(s) for _, s in found), default=0)
        for rule, candidate in found:
            if len(candidate) >= 0.2 * most:
                series[group] = candidate
                if rule.note:
                    derived.update(dict.fromkeys(candidate.columns, rule.note))
                break
    return series, derived


def _ordered(t_s: FloatArray, columns: Mapping[str, FloatArray], message: str, losses: list[str]) -> Series:
    """Sorted by time; of samples with one time stamp the last is kept, and the loss is noted."""
    order = np.argsort(t_s, kind="stable")
    t = t_s[order]
    last = np.concatenate([np.diff(t) > 0, [True]]) if t.size else np.zeros(0, dtype=bool)
    doubled = int(t.size - np.count_nonzero(last))
    if doubled > 0.01 * t.size:
        sentence = f"{message}: {doubled} of {t.size} samples repeat a time stamp; the last of each was kept"
        if sentence not in losses:
            losses.append(sentence)
    return Series(t[last], {name: np.asarray(values)[order][last] for name, values in columns.items()})


def _reference(
    collected: StreamDecoder,
    vehicle: SenderId,
    span: tuple[float, float],
    clock: ClockEstimate,
    came: tuple[FloatArray, FloatArray],
    losses: list[str],
) -> tuple[Series | None, str, ClockEstimate]:
    """Targets sent to the vehicle, at their sending time on the vehicle's clock; and the clock, if their stamps pin it better."""
    senders = [rows for (s, kind), rows in collected.rows.items() if kind == "SET_ATTITUDE_TARGET" and s != vehicle]
    if not senders:
        return None, "vehicle", clock
    raws = [rows.raw() for rows in senders]
    raw = {name: np.concatenate([r[name] for r in raws]) for name in raws[0]}
    g = np.concatenate([np.asarray(rows.ground_s) for rows in senders])
    inside = (g >= span[0]) & (g <= span[1]) & np.isin(raw["target_system"], (0, vehicle[0]))  # 0: to everybody
    if not inside.any():
        return None, "vehicle", clock
    raw = {name: values[inside] for name, values in raw.items()}
    g = g[inside]
    stamp_s = raw["time_boot_ms"] * 1e-3
    together = in_lock_step(g, stamp_s, *came)
    if together is not None:
        # What arrives is no envelope of delays then, since the vehicle may be ahead of the ground: the stamps are exact.
        clock = ClockEstimate(np.array(together[:1]), np.array(together[1:]), 1.0, 0.0, "target stamps")
    else:
        late = stamp_s - clock.to_vehicle(g)
        if clock.method == "one-way" and float(np.max(np.abs(late))) < _STAMP_AGREEMENT_S:
            # The sender stamped its targets on the vehicle's clock: its offset is better than one-way delays can give. Its
            # first half minute counts, since some senders look at the vehicle's clock only once.
            early = late[g < g.min() + _STAMP_TRUST_S]
            error = 0.5 * float(np.percentile(early, 90) - np.percentile(early, 10))
            clock = clock.shifted(float(np.median(early)) + HALF_MS, error + _STAMP_S, "target stamps")
        elif (
            clock.method == "timesync"
            and float(np.ptp(late)) > _STAMP_WANDER_S
            and float(np.max(np.abs(late))) < _STAMP_AGREEMENT_S
        ):
            # A simulated vehicle's clock that the sender went along with, and arrivals did not.
            clock = _clock_of_stamps(g, stamp_s + HALF_MS, clock)
        clock = replace(clock, error_s=max(clock.error_s, _STAMP_S))
    return _ordered(clock.to_vehicle(g), reference_columns(raw), "SET_ATTITUDE_TARGET", losses), "ground", clock


def _clock_of_stamps(ground_s: FloatArray, stamp_s: FloatArray, clock: ClockEstimate) -> ClockEstimate:
    """The clock by which targets were stamped, from the first target to the last; beyond them it goes on at the ground's pace."""
    order = np.argsort(ground_s, kind="stable")
    g, v = ground_s[order], np.maximum.accumulate(stamp_s[order])
    rising = np.concatenate([[True], (np.diff(g) > 0) & (np.diff(v) > 0)])
    return ClockEstimate(g[rising], v[rising], 1.0, clock.error_s, "target stamps")


def mode_markers(state: Series) -> list[Marker]:
    """One marker at the first mode (ArduCopter's number) and at each change of it; none where it was not recorded."""
    modes = state.columns.get("mode", np.full(state.t_s.size, np.nan))
    known = np.isfinite(modes)
    t_s, modes = state.t_s[known], modes[known]
    changed = np.flatnonzero(np.diff(modes, prepend=np.nan) != 0)
    return [Marker(float(t_s[i]), "mode", mode_name(int(modes[i])), {"mode": int(modes[i])}) for i in changed]
