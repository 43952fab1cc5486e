"""Preflight: everything that would ruin the data or the vehicle, each with its remedy; and setting parameters, to be restored.

A simulator is excused from what only a field has (a live RC link, a fence), and the notes list it.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping

from flighttest.errors import LinkError, PreflightError
from flighttest.flight.preparation.fence_limits import fence_checks, inside_checks
from flighttest.flight.preparation.situation import Check, Situation
from flighttest.flight.transmitter import received
from flighttest.link.ardupilot import ArduPilot
from flighttest.mavlink.dialect import MULTICOPTERS, Message, dialect, vehicle_kind

THRUST_AS_THRUST = 8
TIMEOUT_S = 0.2
_FAST = 1.5
LOG_BITS = 980991  # fast attitude, fast IMU, motors: what ArduPilot's log needs for a fit (flown)
_LOG_NEEDED = {
    0: "fast attitude: the attitude response",
    18: "fast IMU: the thrust response",
    17: "MOTB: battery compensation",
}
_FS_CONTINUE_GUIDED = 4
BEGIN_SHARE = 0.97  # of the voltage at which a script's repeats begin: a pack below it is reported
_RC_IGNORED, _THROTTLE_CHECKED = 1, 1 << 5  # of RC_OPTIONS
_RESTS_AT_MID = 1  # of PILOT_THR_BHV
RATE_SHARE = 0.8

RATES_HZ: dict[str, float] = {
    "HEARTBEAT": 10.0,
    "ATTITUDE": 100.0,
    "HIGHRES_IMU": 100.0,
    "LOCAL_POSITION_NED": 50.0,
    "ATTITUDE_TARGET": 50.0,
    "BATTERY_STATUS": 10.0,
    "GLOBAL_POSITION_INT": 5.0,
    "VFR_HUD": 10.0,
    "SERVO_OUTPUT_RAW": 10.0,
    "EKF_STATUS_REPORT": 5.0,
    "RC_CHANNELS": 5.0,
    "SYS_STATUS": 2.0,
}
"""Message rates asked for, Hz. HEARTBEAT at 10 Hz, so that a pilot's mode switch is seen within a tenth of a second."""

BLIND_RATES_HZ: dict[str, float] = {"SCALED_PRESSURE": 10.0, "DISTANCE_SENSOR": 10.0, "VFR_HUD": 20.0}
"""What height is read from where there may be no position."""


def rc_live(vehicle: ArduPilot) -> bool:
    """Whether the autopilot receives the pilot's transmitter now: RC_CHANNELS goes on with the last channels when it is off."""
    heard = vehicle.session.latest.get("RC_CHANNELS")
    if heard is None or received(heard.message) is False:
        return False
    status = vehicle.request("SYS_STATUS", dialect.MAVLINK_MSG_ID_SYS_STATUS)
    return status is not None and received(status) is not False  # it may not report it


def figure(value: float) -> str:
    """A parameter's value as a person may type it back: no digit of an integer is lost."""
    return f"{value:.0f}" if float(value).is_integer() else f"{value:.6g}"


def is_simulator(parameters: Mapping[str, float]) -> bool:
    """Whether the vehicle is a simulator: only those have SIM_ parameters."""
    return any(name.startswith("SIM_") for name in parameters)


# What a check may be called after --waive.
NAMES = (
    "plan", "vehicles", "frame", "firmware", "GUID_OPTIONS", "GUID_TIMEOUT", "FLTMODE_GCSBLOCK", "SYSID_ENFORCE", "FS_OPTIONS", "rc",
    "FS_THR_ENABLE", "FLTMODE_CH", "RC_OPTIONS", "fence", "LOG_BITMASK", "rates", "battery", "position", "armed", "attitude",
    "stick", "zone",
)  # fmt: skip


def checks(s: Situation) -> list[Check]:
    """Every reason against flying this plan now."""
    return [*_plan(s), *_firmware(s), *_guided(s), *_safety(s), *_data(s), *_readiness(s)]


def _plan(s: Situation) -> list[Check]:
    if s.plan.legs:
        return []
    refused = "; ".join(f"{leg}: {what}" for leg, what, _ in s.plan.refusals[:3])
    return [Check("plan", f"the plan has no leg that can be flown ({refused})", "run `flighttest check` on the script")]


def _firmware(s: Situation) -> list[Check]:
    found = []
    if s.others:
        named = ", ".join(map(str, sorted(s.others)))
        what = f"there are other vehicles on this link (system {named}): which of them is to fly is not stated"
        found.append(Check("vehicles", what, "give this vehicle a link or a port of its own"))
    found += _frame(s.vehicle_type)
    version = re.match(r"(\d+)\.(\d+)", s.firmware)
    if version is None:
        found.append(
            Check("firmware", "the vehicle does not state its firmware version", "update it to Copter 4.6 or newer")
        )
    else:
        seen = (int(version[1]), int(version[2]))
        turning = any(leg.kind.startswith("yaw") for leg in s.plan.legs)
        needed = (4, 6) if turning else (4, 3)
        if seen < needed:
            what = "yaw rate targets" if turning else "attitude targets with thrust"
            found.append(
                Check(
                    "firmware",
                    f"firmware {s.firmware} is too old for {what}",
                    f"update it to Copter {needed[0]}.{needed[1]} or newer",
                )
            )
    return found


def refuse_other_vehicles(beat: Message, waived: Collection[str] | None = None) -> None:
    """By its first HEARTBEAT, before anything is asked of it. LinkError where the vehicle cannot be ArduCopter, whose numbers of modes mean
    others there (its GUIDED is a rover's HOLD): that cannot be waived. PreflightError for another frame of ArduCopter; waived: None where
    the vehicle is only read, so that there is nothing to waive."""
    kind = vehicle_kind(beat.type)
    if kind and (waived is None or beat.type != dialect.MAV_TYPE_HELICOPTER):
        raise LinkError(
            f"the vehicle is {kind} (type {beat.type} in its HEARTBEAT); only multirotors are flown and modelled",
            "connect to a multirotor: check the URL, and which vehicle is switched on",
        )
    if waived is not None:
        refuse(_frame(beat.type), waived)


def _frame(vehicle_type: int) -> list[Check]:
    if vehicle_type in MULTICOPTERS:
        return []
    what = f"the vehicle is {vehicle_kind(vehicle_type) or 'of a kind that is not known'} (type {vehicle_type} in its HEARTBEAT)"
    return [
        Check("frame", f"{what}, not a multirotor", "connect to a multirotor, or set its FRAME_CLASS where it is one")
    ]


def _guided(s: Situation) -> list[Check]:
    found = []
    options = s.value("GUID_OPTIONS")
    if options is None:
        found.append(Check("GUID_OPTIONS", "the vehicle has no GUID_OPTIONS", "is it ArduCopter 4.1 or newer?"))
    elif not int(options) & THRUST_AS_THRUST:
        wanted = int(options) | THRUST_AS_THRUST
        found.append(
            Check(
                "GUID_OPTIONS",
                f"GUID_OPTIONS is {int(options)}: the throttle would be taken as a climb rate",
                f"set GUID_OPTIONS to {wanted} (or use --set-params)",
                {"GUID_OPTIONS": float(wanted)},
            )
        )
    timeout = s.value("GUID_TIMEOUT")
    # A simulator far above real time gets targets less often than its own clock shows: 0.2 s of its time may be 20 ms of the host's.
    wanted_s = min(TIMEOUT_S * s.pace, 3.0) if s.simulator and s.pace > _FAST else TIMEOUT_S
    if timeout is None or timeout > wanted_s + 1e-3:
        seen = "not known" if timeout is None else f"{timeout:.2g} s"
        found.append(
            Check(
                "GUID_TIMEOUT",
                f"GUID_TIMEOUT is {seen}: a lost link would hold the throttle so long",
                f"set GUID_TIMEOUT to {wanted_s:.2g} (or use --set-params)",
                {"GUID_TIMEOUT": wanted_s},
            )
        )
    blocked = int(s.value("FLTMODE_GCSBLOCK") or 0)
    if blocked:
        found.append(
            Check(
                "FLTMODE_GCSBLOCK",
                f"FLTMODE_GCSBLOCK is {blocked}: it may forbid the modes this flight needs",
                "set FLTMODE_GCSBLOCK to 0 (or use --set-params)",
                {"FLTMODE_GCSBLOCK": 0.0},
            )
        )
    if int(s.value("SYSID_ENFORCE") or 0) or int(s.value("MAV_OPTIONS") or 0) & 1:
        found.append(
            Check(
                "SYSID_ENFORCE",
                "the vehicle listens to one ground station only",
                "set SYSID_ENFORCE to 0 (from 4.7 on: MAV_OPTIONS without bit 0)",
            )
        )
    return found


def _safety(s: Situation) -> list[Check]:
    found = []
    options = int(s.value("FS_OPTIONS") or 0)
    if options & _FS_CONTINUE_GUIDED:
        wanted = options & ~_FS_CONTINUE_GUIDED
        found.append(
            Check(
                "FS_OPTIONS",
                f"FS_OPTIONS is {options}: the vehicle would go on in guided mode without RC",
                f"set FS_OPTIONS to {wanted} (or use --set-params)",
                {"FS_OPTIONS": float(wanted)},
            )
        )
    if s.simulator:
        return found + (fence_checks(s) if s.plan.vehicle.zone.fence == "polygon" else []) + inside_checks(s)
    if not s.rc_live:
        found.append(
            Check(
                "rc",
                "no live RC input is seen",
                "switch the transmitter on; its mode switch is how the pilot takes over",
            )
        )
    return found + _transmitter(s) + fence_checks(s) + inside_checks(s)


def battery_words(s: Situation) -> str:
    """A pack that is not full spreads a script's repeats over less than was asked for: a sentence, else ''."""
    wanted = max((leg.voltage_v or 0.0 for leg in s.plan.legs), default=0.0)
    voltage = s.state.voltage_v
    if voltage is None or voltage >= BEGIN_SHARE * wanted:
        return ""
    return (
        f"the battery begins at {voltage:.1f} V, the script's repeats at {wanted:.1f} V: what depends on voltage (alpha) "
        "will be known less well than with a full pack"
    )


def _transmitter(s: Situation) -> list[Check]:
    """Whether the pilot's switch changes the mode, and what a lost transmitter does."""
    found = []
    if s.value("FS_THR_ENABLE") == 0:
        found.append(
            Check(
                "FS_THR_ENABLE",
                "FS_THR_ENABLE is 0: the vehicle would not notice that the transmitter is lost",
                "set up the radio failsafe (FS_THR_ENABLE 1 or higher, FS_THR_VALUE below the lowest throttle), and try it on the ground",
            )
        )
    if s.value("FLTMODE_CH") == 0:
        found.append(
            Check(
                "FLTMODE_CH",
                "FLTMODE_CH is 0: no switch changes the mode",
                "set FLTMODE_CH to the mode switch's channel",
            )
        )
    options = int(s.value("RC_OPTIONS") or 0)
    if options & _RC_IGNORED:
        found.append(
            Check(
                "RC_OPTIONS",
                f"RC_OPTIONS is {options}: the vehicle ignores the receiver",
                f"set RC_OPTIONS to {options & ~_RC_IGNORED}",
            )
        )
    return found


def _data(s: Situation) -> list[Check]:
    found = []
    bits = s.value("LOG_BITMASK")
    missing = [text for bit, text in _LOG_NEEDED.items() if bits is not None and not int(bits) >> bit & 1]
    if bits is not None and missing:
        wanted = int(bits) | LOG_BITS
        found.append(
            Check(
                "LOG_BITMASK",
                f"LOG_BITMASK is {int(bits)}: the onboard log would lack {'; '.join(missing)}",
                f"set LOG_BITMASK to {wanted} (or use --set-params)",
                {"LOG_BITMASK": float(wanted)},
            )
        )
    wanted_hz = {"ATTITUDE": 0.5 * RATES_HZ["ATTITUDE"], "BATTERY_STATUS": 1.0}
    if not s.simulator:
        wanted_hz["HEARTBEAT"] = 4.0  # a pilot's switch is seen in it
    if s.plan.reset.by == "guided":
        wanted_hz["LOCAL_POSITION_NED"] = 10.0
    if s.rates_hz.get("HIGHRES_IMU", 0.0) < RATE_SHARE * 25.0 and s.rates_hz.get("RAW_IMU", 0.0) < RATE_SHARE * 25.0:
        wanted_hz["HIGHRES_IMU"] = 25.0
    for name, rate in wanted_hz.items():
        seen = s.rates_hz.get(name, 0.0)
        if seen < RATE_SHARE * rate:
            found.append(
                Check(
                    "rates",
                    f"{name} arrives at {seen:.1f} Hz, needed are {rate:.0f} Hz",
                    "use a faster link, or stop other ground stations that set rates",
                )
            )
    return found


def lowest_stick(parameters: Mapping[str, float]) -> float | None:
    """The highest place of the throttle stick, 0..1, in which ArduCopter arms; None where any will do (arming_check_throttle)."""
    behaviour, options = (int(parameters.get(n, 0.0)) for n in ("PILOT_THR_BHV", "RC_OPTIONS"))
    if behaviour & _RESTS_AT_MID or not options & _THROTTLE_CHECKED:
        return None
    channel = int(parameters.get("RCMAP_THROTTLE", 3))
    low_us = parameters.get(f"RC{channel}_MIN", 1100.0) + parameters.get(f"RC{channel}_DZ", 30.0)
    return (low_us - 1000.0) / 1000.0


def _readiness(s: Situation) -> list[Check]:
    found = []
    limit = s.plan.limits.voltage_min_v
    voltage = s.state.voltage_v
    if limit > 0 and voltage is None:
        found.append(Check("battery", "no battery voltage is reported", "set up the battery monitor (BATT_MONITOR)"))
    elif limit > 0 and voltage is not None and voltage <= limit:
        found.append(
            Check("battery", f"the battery has {voltage:.1f} V, the script's limit is {limit:.1f} V", "charge it")
        )
    if s.plan.reset.by == "guided" and not s.state.position_ok:
        found.append(
            Check(
                "position",
                "the vehicle has no position yet, which `reset: by: guided` needs",
                "wait for a satellite fix, or use `by: attitude`",
            )
        )
    if s.state.armed:
        found.append(Check("armed", "the vehicle is armed already", "land and disarm it first"))
    low = None if s.state.armed else lowest_stick(s.parameters)
    if low is not None and s.state.throttle_stick is not None and s.state.throttle_stick > low:
        what = (
            "the throttle stick is not down, and ArduCopter does not arm then (PILOT_THR_BHV bit 0, RC_OPTIONS bit 5)"
        )
        remedy = "lower it until the vehicle is armed, then bring it to mid; PILOT_THR_BHV 1 is for a stick that rests at mid"
        found.append(Check("stick", what, remedy))
    if s.state.attitude_rad is None:
        found.append(Check("attitude", "no attitude is reported", "check the link"))
    elif (s.state.tilt_rad or 0.0) > 0.35:
        found.append(Check("attitude", "the vehicle stands tilted by more than 20 deg", "stand it level"))
    return found


def home_checks(outside_m: float) -> list[Check]:
    """outside_m: how far home lies outside of the zone's walls, m."""
    if not outside_m > 0.0:
        return []
    what = f"home, where it takes off, is {outside_m:.0f} m outside of the flight zone"
    remedy = "carry it into the zone, or correct the zone; --waive zone where the way to it is free and watched"
    return [Check("zone", what, remedy)]


def refuse(found: list[Check], waived: Collection[str]) -> None:
    """PreflightError with all findings that are not waived by name."""
    left = [check for check in found if check.name not in waived]
    if left:
        raise PreflightError([(f"{check.name}: {check.what}", check.remedy) for check in left])


def refuse_armed(armed: bool) -> None:
    """PreflightError where the vehicle is armed by now: somebody else flies it, and nothing is set on it."""
    if armed:
        raise PreflightError([("armed: the vehicle was armed meanwhile", "land and disarm it first")])


def waiver_notes(found: list[Check], waived: Collection[str]) -> list[str]:
    """A sentence for each finding that was waived: it goes into the record."""
    return [f"waived {check.name}: {check.what}" for check in found if check.name in waived]
