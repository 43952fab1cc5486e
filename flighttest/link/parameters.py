"""Vehicle parameters under either of their names: Copter 4.7 renamed many, and does not answer to the old ones."""

from __future__ import annotations

import struct
from dataclasses import dataclass

from flighttest.errors import LinkError
from flighttest.link.session import Session
from flighttest.mavlink.dialect import COMPONENT_AUTOPILOT, Message, dialect

_TRIES = 4
_ANSWER_S = 1.5
_LIST_QUIET_S = 1.5


@dataclass(frozen=True)
class Renamed:
    """One parameter before and after its renaming. factor: old value = factor x new value (centidegrees against degrees...)."""

    new: str
    old: str
    factor: float = 1.0


# Source: ArduCopter 4.7's parameter conversion tables. SRx_* became MAVn_*, which nothing here needs.
RENAMED: tuple[Renamed, ...] = (
    Renamed("ATC_ANGLE_MAX", "ANGLE_MAX", 100.0),
    Renamed("ATC_ACC_R_MAX", "ATC_ACCEL_R_MAX", 100.0),
    Renamed("ATC_ACC_P_MAX", "ATC_ACCEL_P_MAX", 100.0),
    Renamed("ATC_ACC_Y_MAX", "ATC_ACCEL_Y_MAX", 100.0),
    Renamed("WP_SPD", "WPNAV_SPEED", 100.0),
    Renamed("WP_SPD_UP", "WPNAV_SPEED_UP", 100.0),
    Renamed("WP_SPD_DN", "WPNAV_SPEED_DN", 100.0),
    Renamed("WP_ACC", "WPNAV_ACCEL", 100.0),
    Renamed("MAV_GCS_SYSID", "SYSID_MYGCS"),
    Renamed("MAV_SYSID", "SYSID_THISMAV"),
)
_BY_NAME = {r.new: r for r in RENAMED} | {r.old: r for r in RENAMED}


def other_name(name: str, value: float) -> tuple[str, float] | None:
    """The other name of a parameter with the value in its unit, or None where it was never renamed."""
    renamed = _BY_NAME.get(name)
    if renamed is None:
        return None
    return (renamed.old, value * renamed.factor) if name == renamed.new else (renamed.new, value / renamed.factor)


def by_either_name(parameters: dict[str, float] | None, name: str) -> float | None:
    """A parameter from a table of them, by its new or old name, in the unit of the name asked for; None where it is unknown."""
    if parameters is None:
        return None
    if name in parameters:
        return parameters[name]
    other = other_name(name, 0.0)
    if other is None or other[0] not in parameters:
        return None
    back = other_name(other[0], parameters[other[0]])
    return back[1] if back else None


def read_all(session: Session) -> dict[str, float]:
    """Every parameter the vehicle has. LinkError where some never arrive, saying how many."""
    by_index: dict[int, tuple[str, float]] = {}
    count = 0

    def look(message: Message, _t_s: float) -> None:
        nonlocal count
        if message.get_type() == "PARAM_VALUE" and message.param_index < 0xFFFF:
            by_index[message.param_index] = (message.param_id, _value(session, message))
            count = max(count, message.param_count)

    session.listen(look)
    try:
        for _ in range(_TRIES):
            session.send(
                dialect.MAVLink_param_request_list_message(
                    target_system=session.vehicle_system, target_component=COMPONENT_AUTOPILOT
                )
            )
            _until_quiet(session, by_index)
            if count:
                break
        if count == 0:
            raise LinkError("the vehicle did not answer PARAM_REQUEST_LIST", "is the link two-way?")
        for _ in range(_TRIES):
            missing = [i for i in range(count) if i not in by_index]
            if not missing:
                return dict(by_index[i] for i in range(count))
            for index in missing:
                session.send(_request("", index, session.vehicle_system))
                session.advance(session.now_s() + 0.01)
            _until_quiet(session, by_index)
        missing_count = sum(i not in by_index for i in range(count))
        if missing_count:
            raise LinkError(
                f"{missing_count} of {count} parameters did not arrive", "the link is losing too much: move closer"
            )
        return dict(by_index[i] for i in range(count))
    finally:
        session.forget(look)


def _value(session: Session, message: Message) -> float:
    """A parameter's value: PX4 sends the bytes of an integer in the place of a float."""
    beat = session.latest.get("HEARTBEAT")
    if beat is not None and beat.message.autopilot == dialect.MAV_AUTOPILOT_PX4:
        form = {dialect.MAV_PARAM_TYPE_INT32: "<i", dialect.MAV_PARAM_TYPE_UINT32: "<I"}.get(message.param_type)
        if form is not None:
            return float(struct.unpack(form, struct.pack("<f", message.param_value))[0])
    return float(message.param_value)


def _until_quiet(session: Session, received: dict[int, tuple[str, float]]) -> None:
    """Wait as long as parameters keep coming."""
    last, since = -1, session.now_s()
    while session.now_s() - since < _LIST_QUIET_S * max(session.clock.pace, 1.0):
        session.advance(session.now_s() + 0.05)
        session.require_link()
        if len(received) != last:
            last, since = len(received), session.now_s()


def _request(name: str, index: int, system: int) -> Message:
    return dialect.MAVLink_param_request_read_message(
        target_system=system, target_component=COMPONENT_AUTOPILOT, param_id=name.encode(), param_index=index
    )


def offered(session: Session, name: str) -> float | None:
    """A parameter that most vehicles do not have: asked for twice, since an unknown name is not answered."""
    answer = _ask(session, name, tries=2, answer_s=0.4)
    return None if answer is None else float(answer.param_value)


def _ask(session: Session, name: str, tries: int = _TRIES, answer_s: float = _ANSWER_S) -> Message | None:
    for _ in range(tries):
        session.send(_request(name, -1, session.vehicle_system))
        answer = session.await_message(
            lambda m: m.get_type() == "PARAM_VALUE" and m.param_id == name, answer_s * max(session.clock.pace, 1.0)
        )
        if answer is not None:
            return answer
    return None


def read_parameter(session: Session, name: str) -> float | None:
    """One parameter by either name, in the unit of the name asked for; None where the vehicle has neither (it never answers then)."""
    answer = _ask(session, name)
    if answer is not None:
        return float(answer.param_value)
    other = other_name(name, 0.0)
    if other is None:
        return None
    answer = _ask(session, other[0])
    if answer is None:
        return None
    back = other_name(other[0], float(answer.param_value))
    return back[1] if back else None


def write_parameter(
    session: Session, name: str, value: float, known: dict[str, float], *, stops_time: bool = False
) -> None:
    """Set one parameter (by the name that the vehicle has for it) and read it back. LinkError where it does not hold the value.

    known: the vehicle's parameters; updated. stops_time: the echo of the setting is taken as its read-back, since after it the
    vehicle's time stands still.
    """
    if name not in known:
        other = other_name(name, value)
        if other is None or other[0] not in known:
            raise LinkError(f"the vehicle has no parameter {name}", "is its firmware too old or too new?")
        name, value = other
    seen: float | None = None
    for _ in range(_TRIES):
        session.send(
            dialect.MAVLink_param_set_message(
                target_system=session.vehicle_system,
                target_component=COMPONENT_AUTOPILOT,
                param_id=name.encode(),
                param_value=value,
                param_type=dialect.MAV_PARAM_TYPE_REAL32,
            )
        )
        echo = session.await_message(
            lambda m: m.get_type() == "PARAM_VALUE" and m.param_id == name, _ANSWER_S * max(session.clock.pace, 1.0)
        )
        answer = echo if stops_time else _ask(session, name)
        if answer is not None:
            seen = float(answer.param_value)
            known[name] = seen
            if same_single(seen, value):
                return
    raise LinkError(
        f"{name} does not take {value:g}: it reads {'nothing' if seen is None else f'{seen:g}'}", "set it by hand"
    )


def same_single(seen: float, wanted: float) -> bool:
    """Whether a value read back is the one that was set, in single precision."""
    single = struct.unpack("<f", struct.pack("<f", wanted))[0]
    return bool(abs(seen - single) <= 1e-6 * max(abs(single), 1.0))
