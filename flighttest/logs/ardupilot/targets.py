"""What an ArduPilot vehicle was asked to do, from its dataflash log: targets received, its own targets, throttle in and out."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from flighttest.logs.ardupilot.dataflash import MessageTable, stack
from flighttest.logs.ardupilot.times import Stamped
from flighttest.logs.timing import held_union, ordered
from flighttest.mavlink.accepted import CLIMB_RATES
from flighttest.mavlink.modes import TAKES_ATTITUDE_TARGETS
from flighttest.recording import Series

FloatArray = NDArray[np.float64]
TargetPart = tuple[FloatArray, dict[str, FloatArray]]

# A heading target that moves faster was set anew: 1.5 times what full stick asks for by default (ACRO_YAW_P 4.5 times 45 deg/s).
FASTEST_RAD_S = 1.5 * np.radians(202.5)


class Targets:
    """Reference, shaped and output series of one log.

    tables: messages by name with their times. angles: name, messages and times of the attitude message in use. derived and losses are
    added to.
    """

    def __init__(
        self,
        tables: Mapping[str, Stamped],
        angles: tuple[str, MessageTable, FloatArray] | None,
        derived: dict[str, str],
        losses: list[str],
    ) -> None:
        self.tables = tables
        self.angles = angles
        self.derived = derived
        self.losses = losses

    def _own(self, suffix: str) -> list[TargetPart]:
        """The autopilot's own attitude target, NWU/FLU, with the channels' suffix."""
        if self.angles is None:
            return []
        name, table, t_s = self.angles
        if "DesRoll" not in table or "DesPitch" not in table:
            return []
        target = np.radians(stack(table, "DesRoll", "DesPitch")) * [1.0, -1.0]
        one = ordered(t_s, {f"roll_{suffix}_rad": target[:, 0], f"pitch_{suffix}_rad": target[:, 1]}, name, [])
        return [(one.t_s, dict(one.columns))]

    def _turning(self) -> list[TargetPart]:
        """The rate of its heading target between two samples, at the middle of them; unknown where the target was set anew.

        RATE.YDes is no reference: it is this rate and the correction of the heading error, so that in a flight without commands the yaw
        rate seems to follow what it has caused.
        """
        if self.angles is None or "DesYaw" not in self.angles[1]:
            return []
        name, table, t_s = self.angles
        one = ordered(t_s, {"yaw_rad": np.unwrap(-np.radians(table.get("DesYaw")))}, name, [])
        if len(one) < 2:
            return []
        rate = np.diff(one.columns["yaw_rad"]) / np.diff(one.t_s)
        rate = np.where(np.abs(rate) > FASTEST_RAD_S, np.nan, rate)
        return [(one.t_s[:-1] + 0.5 * np.diff(one.t_s), {"yaw_rate_ref_rad_s": rate})]

    def shaped(self) -> Series | None:
        """What the autopilot itself asked its attitude and yaw rate loops for."""
        parts = self._own("shaped")
        if "RATE" in self.tables:
            table, t_s = self.tables["RATE"]
            one = ordered(t_s, {"yaw_rate_shaped_rad_s": -np.radians(table.get("YDes"))}, "RATE", [])
            parts.append((one.t_s, dict(one.columns)))
        return held_union(parts) if parts else None

    def reference(self, state: Series | None) -> Series | None:
        """What was asked from outside: GUIA, else the autopilot's own targets. state: modes, where a change ends a target."""
        throttle = self._asked_of_the_motors()
        guia = self.tables.get("GUIA")
        if guia is not None:
            table, t_s = guia
            known = np.where(_rates_alone(table), np.nan, 1.0)
            columns = {
                "roll_ref_rad": np.radians(table.get("Roll")) * known,
                "pitch_ref_rad": -np.radians(table.get("Pitch")) * known,
                "yaw_rate_ref_rad_s": -np.radians(table.get("YawRt")),
            }
            thrust = table.get("Thrust")
            direct = bool(np.any(thrust > 0)) or "ClimbRt" not in table or not bool(np.any(table.get("ClimbRt") != 0))
            if direct:
                columns["throttle"] = thrust
            one = ordered(t_s, columns, "GUIA", self.losses)
            parts = [_ended_by_mode(one, state)]
            if not direct and throttle is not None:
                self.derived["throttle"] = f"CTUN: {CLIMB_RATES}"
                parts.append(throttle[0])
            return held_union(parts, 0.0) if len(parts) > 1 else Series(*parts[0])
        parts = [*self._own("ref"), *self._turning()]
        for _, columns in parts:
            for name in columns:
                self.derived[name] = "the autopilot's own target is taken for the reference: the log has no GUIA"
        if throttle is not None:
            self.derived["throttle"] = f"{throttle[1]}; the log has no GUIA"
            parts.append(throttle[0])
        return held_union(parts) if parts else None

    def _asked_of_the_motors(self) -> tuple[TargetPart, str] | None:
        """The throttle that the mode asked for before boost for tilt, and where it comes from: what went to the motors less the boost.

        What a mode that holds its height asks for goes through a low-pass filter of 2 Hz (POSCONTROL_THROTTLE_CUTOFF_FREQ_HZ), which is no
        lag of the motors; until Copter 3.3 ThrIn is the pilot's stick. AOut may have been logged more often than ThO.
        """
        out, boost = self.output(), self._ctun("throttle", "ABst", "AngBst")
        if out is not None and boost is not None:
            lifted = np.interp(out.t_s, boost[0], boost[1]["throttle"])
            asked = np.clip(out.columns["throttle_out"] - lifted, 0.0, 1.0)
            return (out.t_s, {"throttle": asked}), "what went to the motors less the boost for tilt (CTUN)"
        only = self._ctun("throttle", "ThI", "ThrIn")
        return None if only is None else (only, "CTUN: the throttle the mode asked for, before tilt boost")

    def _ctun(self, channel: str, *names: str) -> TargetPart | None:
        """The first of the fields that the log has, 0..1, of those that the autopilot's own throttle is in."""
        if "CTUN" not in self.tables:
            return None
        table, t_s = self.tables["CTUN"]
        name = next((n for n in names if n in table and not (self._old and n == "ThrIn")), None)
        if name is None:
            return None
        one = ordered(t_s, {channel: table.get(name) * (1e-3 if self._old else 1.0)}, "CTUN", [])
        return one.t_s, dict(one.columns)

    @property
    def _old(self) -> bool:
        """Until Copter 3.3 all throttles are 0..1000 and ThrIn an integer, the pilot's; from then on a float, the autopilot's own, 0..1."""
        table, _ = self.tables.get("CTUN", (None, None))
        return table is not None and "ThrIn" in table and table.raw["ThrIn"].dtype.kind == "i"

    def output(self) -> Series | None:
        """Throttle after boost and filters."""
        found = self._ctun("throttle_out", "ThO", "ThrOut")
        if "RATE" in self.tables and "AOut" in self.tables["RATE"][0]:
            table, t_s = self.tables["RATE"]
            if found is None or len(table) > found[0].size:
                return ordered(t_s, {"throttle_out": table.get("AOut") * (1e-3 if self._old else 1.0)}, "RATE", [])
        return Series(*found) if found is not None else None


def _rates_alone(guia: MessageTable) -> NDArray[np.bool_]:
    """Which targets (n,) asked for body rates and no attitude: the autopilot logs the empty quaternion as a level head due north."""
    if not {"Yaw", "RollRt", "PitchRt"} <= set(guia.raw):
        return np.zeros(len(guia), dtype=bool)
    level = np.all(stack(guia, "Roll", "Pitch", "Yaw") == 0.0, axis=1)
    turning = np.any(stack(guia, "RollRt", "PitchRt") != 0.0, axis=1)
    return np.asarray(level & np.any(level & turning))


def _ended_by_mode(series: Series, state_series: Series | None) -> TargetPart:
    """Targets count only in the mode they were sent in: where it changes, the reference becomes unknown (NaN) until the next target."""
    t, columns = series.t_s, dict(series.columns)
    if state_series is None or "mode" not in state_series.columns:
        return t, columns
    mode = state_series.columns["mode"]
    left = np.flatnonzero(np.isin(mode[:-1], TAKES_ATTITUDE_TARGETS) & (mode[1:] != mode[:-1])) + 1
    ends = np.setdiff1d(state_series.t_s[left], t)
    order = np.argsort(np.concatenate([t, ends]), kind="stable")
    blank = np.full(ends.size, np.nan)
    return np.concatenate([t, ends])[order], {n: np.concatenate([v, blank])[order] for n, v in columns.items()}
