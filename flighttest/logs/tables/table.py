"""Plain tables (CSV, Parquet, Crazyflie logs) to a Recording, with a column map for foreign ones.

What can be derived is derived and noted: attitude from a quaternion, velocity from position, acceleration from velocity where there is no
accelerometer. Frames of the table become NWU/FLU here.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from flighttest import frames
from flighttest.channels import CHANNELS, GROUPS, HELD_GROUPS, names
from flighttest.documents import nearest
from flighttest.errors import RecordingError
from flighttest.logs.opening import LogFile, name_of
from flighttest.logs.tables.agreement import disagreements, gravity_warnings
from flighttest.logs.tables.columns import STEP, ColumnMap, ColumnSource, load_columns, plain_map
from flighttest.logs.tables.commanded import misread_commands, sampled_throttle
from flighttest.logs.tables.crazyflie import beyond_limits, crazyflie_map, mixed_commands
from flighttest.logs.tables.reading import read_sheet
from flighttest.logs.tables.ros_bag import MAGIC, read_bag
from flighttest.logs.tables.sheet import TIME, Sheet
from flighttest.logs.timing import difference, ordered, outliers
from flighttest.mavlink.decode import mode_markers
from flighttest.mavlink.telemetry import LEAST_BATTERY_V
from flighttest.recording import Marker, Provenance, Recording, Series

FloatArray = NDArray[np.float64]
Columns = dict[str, FloatArray]

_HALF_TURN_X = np.array([0.0, 1.0, 0.0, 0.0])
_ANGLES = ("roll", "pitch", "yaw")
_WILD_MAX = 0.05
_PIECE_ROWS = 10
_PIECE_GAP_S = 10.0
_OWN_START_S = 1.0  # pieces that were each timed from their own start begin alike
_STEP_MAX_S = 20.0  # a longer piece is no step, but a flight
_SLOWEST_S = 2.0  # between rows of a table in which a flight can show
_TURN_RAD = 2.0 * np.pi
_BEYOND = 0.01  # of the samples: single ones may be damaged
_UPSIDE_DOWN_RAD = np.pi / 2
_WORLD_GROUPS = ("velocity", "position", "acceleration")
_BODY_GROUPS = ("rates", "specific_force")


def import_table(path: Path, columns: Path | str | ColumnMap | None = None) -> Recording:
    """Read a table whose columns are channels, or foreign ones through a column map. RecordingError where that cannot be."""
    file = LogFile(path)
    known = None
    if file.head(len(MAGIC)) == MAGIC:
        sheet, known = read_bag(file)
    else:
        sheet = read_sheet(file)
    given = load_columns(columns) if isinstance(columns, (str, Path)) else columns
    if given is None and known is not None and (known.columns or known.quaternions):
        given = known
    if given is None and sheet.crazyflie:
        given = crazyflie_map(sheet.names)
    plan = given or plain_map(sheet.names)
    losses = sheet.losses + (beyond_limits(sheet) if sheet.crazyflie else [])
    unread = _unread(sheet.names, plan) if given is None else {}
    guesses = [_not_read(name, guess) for name, guess in unread.items() if guess]
    if given is None:
        if not [n for n in plan.columns if n in CHANNELS]:
            shown = ", ".join(sheet.names[:12])
            raise RecordingError(
                f"{path}: no column of this table is a channel ({shown})",
                "; ".join([*guesses, *sheet.losses, "describe it with --columns map.yaml (docs/formats.md)"]),
            )
        losses += [_not_read(name, guess) for name, guess in unread.items()]
    t_s, pieces = _one_after_another(_tame(_time(path, sheet, plan), losses), losses)
    derived: dict[str, str] = {}
    found = _channels(sheet, plan, derived, path)
    if sheet.crazyflie:
        for motor, command in mixed_commands(sheet).items():
            if motor not in found:
                found[motor] = command
                derived[motor] = (
                    "thrust and torque commands, mixed as the firmware does (power_distribution_quadrotor.c)"
                )
    _without_battery(found, losses)
    if "throttle" in found and (sampled := sampled_throttle(t_s, found["throttle"])) is not None:
        found["throttle"] = sampled[0]
        losses.append(sampled[1])
    losses += [*disagreements(t_s, found), *misread_commands(t_s, found)]
    _derive(t_s, found, derived)
    series = _grouped(t_s, found, losses)
    if not {"attitude", "specific_force", "acceleration", "velocity"} & set(series):
        have = ", ".join(found) or "nothing"
        remedy = "measurements of a thrust stand are not a flight; name the columns of motion in the column map"
        raise RecordingError(
            f"{path}: neither attitude nor acceleration nor velocity nor position is in the table (found {have})",
            "; ".join([*guesses, remedy]),
        )
    if "throttle" in found:
        _check_throttle(path, found["throttle"])
    _check_angles(path, found)
    losses += gravity_warnings(found, plan.body, mapped=given is not None)
    step = sheet.column(plan.columns[STEP].columns[0]) if STEP in plan.columns else pieces
    markers = _steps(t_s, step) if step is not None else []
    if "state" in series:
        markers = sorted([*markers, *mode_markers(series["state"])], key=lambda m: m.t_s)
    return Recording(
        name=name_of(path),
        series=series,
        markers=tuple(markers),
        provenance=Provenance(
            source=str(path),
            importer="table",
            sha256=file.sha256,
            clock={"method": "table", "offset_s": 0.0, "error_s": 0.0},
            losses=tuple(losses),
            filters=dict(plan.filters_hz),
            derived=derived,
        ),
    )


def _unread(columns: Sequence[str], plan: ColumnMap) -> dict[str, str]:
    """Columns that are no channel, each with the channel that may have been meant, '' where none is near."""
    unread = [n for n in columns if n not in plan.columns and n and not n.startswith("Unnamed")]
    return {name: nearest(name, (*CHANNELS, TIME, STEP)) or "" for name in unread}


def _not_read(name: str, guess: str) -> str:
    return f"column {name!r} is not a channel and was not read" + (f"; did you mean {guess}?" if guess else "")


def _time(path: Path, sheet: Sheet, plan: ColumnMap) -> FloatArray:
    own = sheet.raw.get(TIME) if plan.rate_hz is None else None  # a bag's or MATLAB file's, where the map names none
    if TIME in plan.columns or own is not None:
        t_s = _read(sheet, plan, TIME) if TIME in plan.columns else sheet.column(TIME)
        # Epoch times lose their microseconds in arithmetic, and are not legible.
        if np.isfinite(t_s).any() and float(np.nanmin(t_s)) > 1e8:
            t_s = t_s - float(np.nanmin(t_s))
    elif plan.rate_hz is not None:
        t_s = np.arange(sheet.rows) / plan.rate_hz
    else:
        raise RecordingError(
            f"{path}: the table has no time",
            "add a column t_s, map one (t_s: {from: ...}), or give rate_hz in the column map",
        )
    finite = t_s[np.isfinite(t_s)]
    if finite.size > 1 and float(np.ptp(finite)) <= 0:
        raise RecordingError(
            f"{path}: all {finite.size} time stamps are the same ({finite[0]:g})",
            "map the column that counts time, or give rate_hz in the column map",
        )
    if finite.size < 2:
        raise RecordingError(
            f"{path}: column t_s has {finite.size} usable values, too few for a recording", "check the column map"
        )
    usual = float(np.median(np.diff(np.unique(finite))))
    if usual > _SLOWEST_S:
        raise RecordingError(
            f"{path}: the rows are {usual:g} s apart, too far to show a step",
            "t_s is in seconds; name the unit of another one in the column map, as in t_s: {from: time, unit: us}",
        )
    return t_s


def _tame(t_s: FloatArray, losses: list[str]) -> FloatArray:
    """Without single stamps far from their neighbours: they are damaged (NaN), where the rest makes sense."""
    t_s = np.where(np.isfinite(t_s), t_s, np.nan)  # an infinite time is none
    apart_s = np.abs(np.diff(t_s))
    apart_s = apart_s[np.isfinite(apart_s)]
    if not apart_s.size or float(np.median(apart_s)) > 0.2:  # too slow a table to decide, or no two times in a row
        return t_s
    wild = outliers(t_s)
    if not wild.any() or np.count_nonzero(wild) > _WILD_MAX * wild.size:
        return t_s
    row = int(np.flatnonzero(wild)[0])
    losses.append(
        f"{int(np.count_nonzero(wild))} rows have a damaged time and were dropped (the first is data row {row + 1})"
    )
    return np.where(wild, np.nan, t_s)


def _one_after_another(t_s: FloatArray, losses: list[str]) -> tuple[FloatArray, FloatArray | None]:
    """A table whose time starts anew, as one whose steps were each timed from their own start: the pieces in a row, with their number
    (n,), else None. A table that is merely out of order stays as it is; a clock that stepped back in flight makes no steps of its
    pieces, which begin at other times than the first; nor are whole flights steps."""
    known = np.flatnonzero(np.isfinite(t_s))  # between tables that were joined stands a line of names again
    starts = known[1:][np.diff(t_s[known]) < 0]
    bounds = np.concatenate([[0], starts, [t_s.size]])
    if not starts.size or int(np.min(np.diff(bounds))) < _PIECE_ROWS:
        return t_s, None
    out, number, end = t_s.copy(), np.zeros(t_s.size), -_PIECE_GAP_S
    for k, (a, b) in enumerate(pairwise(bounds)):
        out[a:b] += end + _PIECE_GAP_S - float(t_s[known[np.searchsorted(known, a)]])
        number[a:b] = k + 1.0
        end = float(np.nanmax(out[a:b]))
    losses.append(
        f"time starts anew {starts.size} times: the {starts.size + 1} pieces were put {_PIECE_GAP_S:g} s apart"
    )
    lengths_s = [float(np.nanmax(out[a:b]) - np.nanmin(out[a:b])) for a, b in pairwise(bounds)]
    anew = bool(np.all(np.abs(t_s[starts] - t_s[known[0]]) < _OWN_START_S)) and max(lengths_s) < _STEP_MAX_S
    return out, number if anew else None


def _read(sheet: Sheet, plan: ColumnMap, name: str) -> FloatArray:
    source = plan.columns[name]
    parts = [_mapped(sheet.column(column), source) for column in source.columns]
    values = parts[0] if len(parts) == 1 else np.mean(parts, axis=0)
    return np.asarray(values * source.scale + source.offset)


def _mapped(values: FloatArray, source: ColumnSource) -> FloatArray:
    """A column through its static map: thrust of a rotor goes with the square of its speed, or as a stand has measured."""
    if source.power != 1.0:
        values = np.sign(values) * np.abs(values) ** source.power
    return values if source.table is None else source.table.of(values)


def _channels(sheet: Sheet, plan: ColumnMap, derived: dict[str, str], path: Path) -> Columns:
    raw = {name: _read(sheet, plan, name) for name in plan.columns if name in CHANNELS}
    for name, value in plan.constants.items():
        raw[name] = np.full(sheet.rows, value)
        derived[name] = "a constant of the column map"
    out = _to_nwu(raw, plan)
    for kind, columns in plan.quaternions.items():
        rpy = _from_quaternion(sheet, plan, columns, path)
        suffix = "_rad" if kind == "attitude" else "_ref_rad"
        for i, angle in enumerate(_ANGLES if kind == "attitude" else _ANGLES[:2]):
            out[f"{angle}{suffix}"] = rpy[:, i]
            derived[f"{angle}{suffix}"] = f"from the quaternion ({', '.join(columns)})"
    return out


def _to_nwu(raw: Columns, plan: ColumnMap) -> Columns:
    """Channels in the table's frames as NWU/FLU. Axes are turned one by one, so that a missing one costs only itself."""
    out = dict(raw)
    for group in _WORLD_GROUPS:
        x, y, z = names(group)
        if plan.world == "ENU":
            for name in (x, y):
                out.pop(name, None)
            if y in raw:
                out[x] = raw[y]
            if x in raw:
                out[y] = -raw[x]
        elif plan.world == "NED":
            out.update({name: -raw[name] for name in (y, z) if name in raw})
    if plan.body == "FRD":
        for group in _BODY_GROUPS:
            out.update({name: -raw[name] for name in names(group)[1:] if name in raw})
        turned = ("pitch_rad", "pitch_ref_rad", "pitch_shaped_rad", "yaw_rate_ref_rad_s", "yaw_rate_shaped_rad_s")
        out.update({name: -raw[name] for name in turned if name in raw})
    if "yaw_rad" in raw:
        yaw = raw["yaw_rad"]
        turned_yaw = {"NWU": yaw, "NED": -yaw, "ENU": yaw - np.pi / 2}[plan.world]
        out["yaw_rad"] = np.asarray(frames.wrap_angle(turned_yaw))
    return out


def _from_quaternion(sheet: Sheet, plan: ColumnMap, columns: tuple[str, ...], path: Path) -> FloatArray:
    q = np.stack([sheet.column(name) for name in columns], axis=-1)
    length = np.linalg.norm(q, axis=-1, keepdims=True)
    with np.errstate(invalid="ignore", divide="ignore"):
        q = np.where(np.abs(length - 1.0) < 0.2, q / length, np.nan)
    if not np.isfinite(q).any():
        raise RecordingError(
            f"{path}: {', '.join(columns)} are not a unit quaternion (median length {float(np.nanmedian(length)):.3g})",
            "list the columns in the order w, x, y, z",
        )
    if plan.body == "FRD":
        q = frames.quaternion_multiply(q, _HALF_TURN_X)
    if plan.world == "NED":
        q = frames.quaternion_multiply(_HALF_TURN_X, q)
    elif plan.world == "ENU":
        q = frames.quaternion_enu_to_nwu(q)
    tilt = np.arccos(np.clip(1.0 - 2.0 * (q[:, 1] ** 2 + q[:, 2] ** 2), -1.0, 1.0))
    if float(np.nanmedian(tilt)) > _UPSIDE_DOWN_RAD:
        raise RecordingError(
            f"{path}: by the quaternion {', '.join(columns)} the vehicle flies upside down",
            "list the columns in the order w, x, y, z, and check `frame:` (world NWU, NED or ENU; body FLU or FRD)",
        )
    return frames.euler_from_quaternion(q)


def _derive(t_s: FloatArray, found: Columns, derived: dict[str, str]) -> None:
    """Velocity from position, and acceleration from velocity where there is no accelerometer: central differences."""
    v, p, f, a = names("velocity"), names("position"), names("specific_force"), names("acceleration")
    for rate, place in zip(v, p, strict=True):
        if rate not in found and place in found:
            found[rate] = difference(t_s, found[place])
            derived[rate] = f"central differences of {place}"
    if not any(name in found for name in (*f, *a)):
        for acceleration, rate in zip(a, v, strict=True):
            if rate in found:
                found[acceleration] = difference(t_s, found[rate])
                derived[acceleration] = f"central differences of {rate}: there is no accelerometer"
    if "height_m" not in found and "p_z_m" in found:
        found["height_m"] = found["p_z_m"]
        derived["height_m"] = "p_z_m: the ground is taken to lie at the origin's height"


def _without_battery(found: Columns, losses: list[str]) -> None:
    """Voltages that no flying battery has are missing ones."""
    volts = found.get("voltage_v")
    if volts is None:
        return
    dead = np.isfinite(volts) & ~(volts > LEAST_BATTERY_V)
    if dead.any():
        found["voltage_v"] = np.where(dead, np.nan, volts)
        losses.append(
            f"voltage_v: {np.count_nonzero(dead)} values of {LEAST_BATTERY_V:g} V or less are taken as missing"
        )


def _grouped(t_s: FloatArray, found: Columns, losses: list[str]) -> dict[str, Series]:
    series: dict[str, Series] = {}
    for group in GROUPS:
        columns = {name: found[name] for name in names(group) if name in found}
        if not columns:
            continue
        # A slow group in a fast table has empty cells between its samples: they are no gaps.
        present = np.isfinite(np.stack(list(columns.values()))).any(axis=0) & np.isfinite(t_s)
        if not present.any():
            losses.append(f"{', '.join(columns)}: no values")
            continue
        if group not in HELD_GROUPS:
            present &= _fresh(columns)
        series[group] = ordered(t_s[present], {n: v[present] for n, v in columns.items()}, group, losses)
    return series


def _fresh(columns: Columns) -> NDArray[np.bool_]:
    """Rows that carry a new sample: where a slower group is repeated at an even pace until its next one, only the first of each."""
    table = np.stack(list(columns.values()))
    same = np.all((table[:, 1:] == table[:, :-1]) | (np.isnan(table[:, 1:]) & np.isnan(table[:, :-1])), axis=0)
    new = np.concatenate([[True], ~same])
    spacing = np.diff(np.flatnonzero(new))
    if spacing.size < 10:
        return np.ones(new.size, dtype=bool)
    usual = int(np.median(spacing))
    even = np.count_nonzero(np.abs(spacing - usual) <= max(1, usual // 4)) > 0.9 * spacing.size
    return new if usual >= 2 and even else np.ones(new.size, dtype=bool)


def _check_throttle(path: Path, throttle: FloatArray) -> None:
    low, high = float(np.nanmin(throttle)), float(np.nanmax(throttle))
    if high > 1.5 or low < -0.1:
        raise RecordingError(
            f"{path}: throttle goes from {low:g} to {high:g}; it must run from 0 to 1",
            "give `scale:` in the column map",
        )


def _check_angles(path: Path, found: Columns) -> None:
    for name, values in found.items():
        if CHANNELS[name].unit != "rad" or not name.startswith(("roll", "pitch")):
            continue
        known = np.abs(values[np.isfinite(values)])
        if np.count_nonzero(known > _TURN_RAD) > _BEYOND * known.size:
            raise RecordingError(
                f"{path}: {name} goes up to {float(np.max(known)):g}; in radians that is more than a turn",
                "for degrees give `unit: deg` in the column map",
            )


def _steps(t_s: FloatArray, step: FloatArray) -> list[Marker]:
    """One leg per step number; rows without a number or with a negative one lie between steps, and so do those with 0 where the
    table returns to it."""
    number = np.where(np.isfinite(step), step, -1.0)
    if np.unique(number).size < 2:  # numbers nothing
        return []
    zeros = np.flatnonzero(number == 0)
    if zeros.size and zeros[-1] - zeros[0] + 1 > zeros.size:
        number[zeros] = -1.0
    starts = np.flatnonzero(np.concatenate([[True], np.diff(number) != 0]))
    markers: list[Marker] = []
    for i in starts:
        if not np.isfinite(t_s[i]):
            continue
        if number[i] >= 0:
            label = f"step {number[i]:g}"
            markers.append(Marker(float(t_s[i]), "leg", label, {"leg": label, "step": float(number[i])}))
        elif markers:
            markers.append(Marker(float(t_s[i]), "phase", "end", {"leg": markers[-1].label}))
    return markers
