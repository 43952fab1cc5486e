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
        """The autopilot's own attitude and yaw rate targets, NWU/FLU, with the channels' suffix."""
        parts: list[TargetPart] = []
        angles = self.angles
        if angles is not None and "DesRoll" in angles[1] and "DesPitch" in angles[1]:
            table = angles[1]
            target = np.radians(stack(table, "DesRoll", "DesPitch")) * [1.0, -1.0]
            columns = {f"roll_{suffix}_rad": target[:, 0], f"pitch_{suffix}_rad": target[:, 1]}
            one = ordered(angles[2], columns, angles[0], [])
            parts.append((one.t_s, dict(one.columns)))
        if "RATE" in self.tables:
            table, t_s = self.tables["RATE"]
            one = ordered(t_s, {f"yaw_rate_{suffix}_rad_s": -np.radians(table.get("YDes"))}, "RATE", [])
            parts.append((one.t_s, dict(one.columns)))
        return parts

    def shaped(self) -> Series | None:
        """What the autopilot itself asked its attitude and yaw rate loops for."""
        parts = self._own("shaped")
        return held_union(parts) if parts else None

    def reference(self, state: Series | None) -> Series | None:
        """What was asked from outside: GUIA, else the autopilot's own targets. state: modes, where a change ends a target."""
        throttle = self._ctun("throttle", "ThI", "ThrIn")
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
                parts.append(throttle)
            return held_union(parts, 0.0) if len(parts) > 1 else Series(*parts[0])
        parts = self._own("ref")
        for _, columns in parts:
            for name in columns:
                self.derived[name] = "the autopilot's own target is taken for the reference: the log has no GUIA"
        if throttle is not None:
            self.derived["throttle"] = "CTUN: the throttle the mode asked for, before tilt boost; the log has no GUIA"
            parts.append(throttle)
        return held_union(parts) if parts else None

    def _ctun(self, channel: str, name: str, old: str) -> TargetPart | None:
        if "CTUN" not in self.tables:
            return None
        table, t_s = self.tables["CTUN"]
        if name in table:
            values = table.get(name)
        elif old in table:
            values = table.get(old) * 1e-3  # 0..1000 before Copter 3.3
        else:
            return None
        one = ordered(t_s, {channel: values}, "CTUN", [])
        return one.t_s, dict(one.columns)

    def output(self) -> Series | None:
        """Throttle after boost and filters."""
        found = self._ctun("throttle_out", "ThO", "ThrOut")
        if "RATE" in self.tables and "AOut" in self.tables["RATE"][0]:
            table, t_s = self.tables["RATE"]
            if found is None or len(table) > found[0].size:
                return ordered(t_s, {"throttle_out": table.get("AOut")}, "RATE", [])
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
