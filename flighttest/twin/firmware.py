"""An identified model under the real ArduCopter firmware: a frame whose closed attitude loops come out as identified.

A model's attitude loops are closed ones, autopilot included. With the gains that the vehicle recorded, one frame gives them: the angular
acceleration of a full output and the lag of the motors are fitted, axis by axis, so that `firmware_loops` answers steps as the vehicle
did: by the mean responses that the model file keeps of its flights, whose form no second-order loop has, else by the model's own answers.
The moments grow with the voltage as the thrust does, since they are of the same motors. Where an axis' gains are not known, or cannot
give the identified loop, gains are chosen as well, and the notes state it. Thrust, drag and every other term of the translation are the
model's own; the motors' static curve is in them, so the firmware's is off.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from flighttest.identify.models.model_file import ModelFile
from flighttest.link.ardupilot import UNSHAPED_LAG_S, SentHeading
from flighttest.physics.catalogue import catalogue
from flighttest.physics.compose import block_of
from flighttest.physics.simulate import simulate
from flighttest.sim import SimOptions
from flighttest.sim.plants.plant import IdentifiedVehicle
from flighttest.twin import firmware_loops
from flighttest.twin.firmware_loops import AXES, LOOP_S, THRUST_DELAY_S, Loop, loop_of
from flighttest.twin.vehicle import simulator_options

FloatArray = NDArray[np.float64]

STEPS = {
    "roll": (0.2, 0.4),
    "pitch": (0.2, 0.4),
    "yaw": (1.0,),
}  # rad, rad/s: of the paper's maneuvers, where none were kept
SECONDS = 1.2
DIVERGED = 1e3  # residual of a loop that is not stable, as a share of the step
NEAR = 0.05  # RMS error of a step, as a share of it, up to which the recorded gains are taken for those that flew
GAIN_RAD_S2 = 400.0  # of a frame whose gains are chosen: ArduCopter's stock simulated quadrotor makes 404
STARTS_RAD_S2 = (30.0, 100.0, 300.0, 1000.0)
LAG_S = (0.002, 0.2)
NO_LAG_S = (5e-4, 1e-3)  # of motors without one
CHOSEN_LAG_S = 0.01  # where gains are chosen
HEADING_P_1_S = 2.0  # least chosen gain of the heading: a yaw rate step is followed best with none, and nothing would hold the heading
DELAY_S = (-0.1, 0.4)  # below zero where the ground's clock is badly known
_COMMAND_S = 0.02  # between targets
_OUTPUT = {"roll": "roll_rad", "pitch": "pitch_rad", "yaw": "r_rad_s"}
_REFERENCE = {"roll": "roll_ref_rad", "pitch": "pitch_ref_rad", "yaw": "yaw_rate_ref_rad_s"}
_IN_THE_FIRMWARE = ("angle_boost", "channel_delay")  # beside the terms of the attitude block
_NOT_BY_A_FRAME = ("velocity_latency",)  # the estimator is the firmware's own
_LINEAR = {
    "MOT_THST_EXPO": 0.0, "MOT_SPIN_ARM": 0.0, "MOT_SPIN_MIN": 0.0, "MOT_SPIN_MAX": 1.0, "MOT_PWM_MIN": 1000.0, "MOT_PWM_MAX": 2000.0,
    "MOT_BAT_VOLT_MAX": 0.0, "MOT_BAT_VOLT_MIN": 0.0, "PILOT_THR_FILT": 0.0, "FRAME_CLASS": 1.0, "FRAME_TYPE": 1.0,
}  # fmt: skip


@dataclass(frozen=True)
class Wanted:
    """An answer to one step. t_s, answer: (n,) s since the step, rad or rad/s; gain: moments at its voltage, in those at the nominal one;
    flown: by the vehicle itself."""

    step: float
    t_s: FloatArray
    answer: FloatArray
    gain: float = 1.0
    flown: bool = False


@dataclass(frozen=True)
class Axis:
    """What was fitted for one axis. gain: angular acceleration of a full output, rad/s^2; lag_s: of its motors; delay_s: of the link and
    all else ahead of the firmware; error: RMS over the steps, as a share of them; gains: chosen ones, {} where the recorded ones fly;
    flown: by steps as they were flown, not as the model answers them."""

    gain: float
    lag_s: float
    delay_s: float
    error: float
    gains: Mapping[str, float]
    flown: bool = False


@dataclass(frozen=True)
class FirmwareFrame:
    """axes: by name; parameters: for the firmware; not_represented: terms that a frame cannot have; notes: what the user must read."""

    axes: Mapping[str, Axis]
    parameters: Mapping[str, float]
    not_represented: tuple[str, ...]
    notes: tuple[str, ...]

    @property
    def link_delay_s(self) -> float:
        """Delay ahead of the firmware, s: of the link that was recorded."""
        return float(np.mean([a.delay_s for n, a in self.axes.items() if n != "yaw"]))

    @property
    def sentences(self) -> tuple[str, ...]:
        """What was chosen, and what such a frame cannot be."""
        chosen = ", ".join(
            f"{n} {a.gain:.0f} rad/s^2 at full output through {1e3 * a.lag_s:.0f} ms (leaves {a.error:.1%} of a step)"
            for n, a in self.axes.items()
        )
        lacking = " and ".join(self.not_represented)
        return (
            f"frame by the {'steps as flown' if all(a.flown for a in self.axes.values()) else 'identified loops'}: {chosen}",
            *self.notes,
            *([f"{lacking}: not in it, since the firmware has an estimator of its own"] if lacking else []),
            f"{1e3 * self.link_delay_s:.0f} ms of the identified delay are of the recorded link: not in it",
        )


def firmware_options(
    stored: ModelFile, hide: Mapping[str, Mapping[str, float]] | None = None, **others: Any
) -> tuple[SimOptions, FirmwareFrame]:
    """`SimOptions` for `launch_on_physics`, and the frame in them. ModelError where the model has no attitude loops."""
    made = simulator_options(stored, hide, **others)
    frame = frame_of(stored)
    assert made.model is not None
    terms = [t for t in stored.model.terms if t == "body" or not _firmwares(t, frame.not_represented)]
    described: IdentifiedVehicle = {
        **made.model,
        "terms": terms,
        "frame": {
            **{f"gain_{n}": a.gain for n, a in frame.axes.items()},
            **{f"lag_{n}": a.lag_s for n, a in frame.axes.items()},
            "thrust_delay": max(stored.delays_s["thrust"] - frame.link_delay_s - THRUST_DELAY_S, 0.0),
        },
    }
    described["constants"] = {**described["constants"], "attitude_loops": False}
    described["noise"] = {k: v for k, v in described["noise"].items() if k == "accel_m_s2"}
    return replace(made, model=described, parameters={**made.parameters, **frame.parameters}), frame


def frame_of(stored: ModelFile, motor_lag: bool = True) -> FirmwareFrame:
    """Fit the frame; the firmware's parameters are the recorded ones as far as they can give the identified loops. motor_lag: whether the
    motors of the target have one."""
    lags = LAG_S if motor_lag else NO_LAG_S
    known = {n: float(v) for n, v in (stored.fingerprint.get("shaping_parameters") or {}).items()}
    attitude = {n: v for n, v in firmware_loops.current_names(known).items() if n.startswith(("ATC_", "INS_GYRO"))}
    recorded = {n: v for n, v in attitude.items() if n in firmware_loops.DEFAULTS}
    axes = {
        n: frame_of_axis(stored, n, loop_of(n, recorded), lags)
        for n, (_, name) in AXES.items()
        if f"ATC_RAT_{name}_P" in recorded
    }
    far = [n for n in AXES if n not in axes or axes[n].error > NEAR]
    if far != ["yaw"] and far:
        far = list(AXES)  # shaping and gyro filter are of all axes
        attitude |= {"ATC_RATE_FF_ENAB": float("reference_shaping" in stored.model.terms), "INS_GYRO_FILTER": 80.0}
    notes = []
    for n in far:
        before = (
            f"the recorded gains leave {axes[n].error:.1%} of a {n} step" if n in axes else f"no gains of {n} known"
        )
        attitude |= _around(stored, n)
        axes[n] = _with_gains(stored, n, loop_of(n, attitude), CHOSEN_LAG_S if motor_lag else NO_LAG_S[0])
        attitude |= axes[n].gains
        notes.append(f"{before}: gains are chosen that leave {axes[n].error:.1%}")
    boost = "angle_boost" in stored.model.terms and stored.values.get("boost", 0.0) > 0.5
    attitude.setdefault("ATC_ANGLE_BOOST", float(boost))
    hover = _hover(stored)
    lacking = tuple(t for t in stored.model.terms if t in _NOT_BY_A_FRAME)
    return FirmwareFrame(
        axes, {**attitude, **_LINEAR, "MOT_THST_HOVER": min(max(hover, 0.125), 0.68)}, lacking, tuple(notes)
    )


def _firmwares(term: str, lacking: tuple[str, ...]) -> bool:
    """Whether a term is the firmware's part, or none of a frame."""
    known = catalogue()[term]
    return (
        term in _IN_THE_FIRMWARE or term in lacking or (block_of(known) == "attitude" and known.family == "autopilot")
    )


def _around(stored: ModelFile, axis: str) -> dict[str, float]:
    """What else than its gains an axis needs: no filters that slow it, and shaping where the model has it."""
    v, terms = stored.values, stored.model.terms
    letter, name = AXES[axis]
    shaped = "reference_shaping" in terms
    found = {f"ATC_RATE_{letter}_MAX": 0.0, f"ATC_ACCEL_{letter}_MAX": 0.0}
    found |= {f"ATC_RAT_{name}_{n}": 0.0 for n in ("D", "FF", "FLTT", "FLTE")}
    if shaped and axis != "yaw":
        found["ATC_INPUT_TC"] = v["shaping_tc"]
        found[f"ATC_ACCEL_{letter}_MAX"] = 100.0 * math.degrees(v["shaping_accel"])
    if "yaw_rate_shaping" in terms and axis == "yaw":
        found["ATC_ACCEL_Y_MAX"] = 100.0 * math.degrees(v["shaping_yaw_accel"])
    return found


def frame_of_axis(stored: ModelFile, axis: str, loop: Loop, lags: tuple[float, float] = LAG_S) -> Axis:
    """Gain and lag of the frame under this loop."""
    wanted, most = wanted_answers(stored, axis), min(2.0 * _hover(stored), 1.0)

    def made(x: FloatArray) -> list[FloatArray]:
        return _answers(axis, loop, math.exp(x[0]), math.exp(x[1]), wanted, most)

    x, error, delay = _least(
        wanted, made, [[math.log(g), math.log(math.sqrt(lags[0] * lags[1]))] for g in STARTS_RAD_S2], (1.0, lags)
    )
    return Axis(math.exp(x[0]), math.exp(x[1]), delay, error, {}, wanted[0].flown)


def step_error(stored: ModelFile, axis: str, frame: FirmwareFrame, ratio: float) -> float:
    """RMS error of the steps of an axis, as a share of them, where the frame's moments are `ratio` times those that were fitted."""
    fitted, loop = frame.axes[axis], loop_of(axis, frame.parameters)
    wanted, most = wanted_answers(stored, axis), min(2.0 * _hover(stored), 1.0)
    made = _answers(axis, loop, fitted.gain * ratio, fitted.lag_s, wanted, most)
    return float(np.sqrt(np.mean(_off(wanted, made, fitted.delay_s) ** 2)))


def _off(wanted: Sequence[Wanted], made: Sequence[FloatArray], delay_s: float) -> FloatArray:
    """Answers of the loop (n,) at its rate, delayed, less the wanted ones, as shares of the steps, one behind the other. Of a loop that
    diverges they are `DIVERGED`: no least squares begins at what is not finite."""
    off: FloatArray = np.concatenate(
        [
            (np.interp(w.t_s - delay_s, LOOP_S * np.arange(y.size), y) - w.answer) / w.step
            for w, y in zip(wanted, made, strict=True)
        ]
    )
    return np.asarray(np.clip(np.nan_to_num(off, nan=DIVERGED), -DIVERGED, DIVERGED), dtype=float)


def _with_gains(stored: ModelFile, axis: str, loop: Loop, lag: float) -> Axis:
    """Gains for a frame that turns with `GAIN_RAD_S2` at once."""
    wanted, most = wanted_answers(stored, axis), min(2.0 * _hover(stored), 1.0)
    v, name = stored.values, AXES[axis][1]
    if axis == "yaw":
        start, least = [math.log(1.1 * HEADING_P_1_S), math.log(v["sigma_r"] / GAIN_RAD_S2)], HEADING_P_1_S
    else:
        w, zeta = (v["omega_phi"], v["zeta_phi"]) if axis == "roll" else (v["omega_theta"], v["zeta_theta"])
        start, least = [math.log(w / (2.0 * zeta)), math.log(2.0 * zeta * w / GAIN_RAD_S2)], 0.01

    def settled(x: FloatArray) -> Loop:
        angle, rate = math.exp(x[0]), math.exp(x[1])
        return replace(loop, angle_p=angle, rate_p=rate, rate_i=0.1 * rate)

    def made(x: FloatArray) -> list[FloatArray]:
        return _answers(axis, settled(x), GAIN_RAD_S2, lag, wanted, most)

    x, error, delay = _least(wanted, made, [start], (least, (1e-4, 5.0)))
    found = settled(x)
    gains = {f"ATC_ANG_{name}_P": found.angle_p, f"ATC_RAT_{name}_P": found.rate_p, f"ATC_RAT_{name}_I": found.rate_i}
    return Axis(GAIN_RAD_S2, lag, delay, error, gains, wanted[0].flown)


def _least(
    wanted: Sequence[Wanted],
    made: Callable[[FloatArray], list[FloatArray]],
    starts: list[list[float]],
    bounds: tuple[float, tuple[float, float]],
) -> tuple[FloatArray, float, float]:
    """Least squares over two logarithms and the delay from the best of some starts; (the two, RMS share of the step, delay s)."""
    known: dict[tuple[float, ...], list[FloatArray]] = {}

    def off(x: FloatArray) -> FloatArray:
        key = tuple(x[:2])
        if key not in known:
            known[key] = made(x)
        return _off(wanted, known[key], x[2])

    lower = [math.log(bounds[0]), math.log(bounds[1][0]), DELAY_S[0]]
    upper = [math.log(1e4), math.log(bounds[1][1]), DELAY_S[1]]
    start = min(([*s, 0.03] for s in starts), key=lambda x: float(np.sum(off(np.array(x)) ** 2)))
    found = least_squares(off, start, bounds=(lower, upper), diff_step=1e-4, max_nfev=40)
    return found.x[:2], float(np.sqrt(np.mean(found.fun**2))), float(found.x[2])


def wanted_answers(stored: ModelFile, axis: str) -> list[Wanted]:
    """Steps as they were flown, where the model file keeps them, else the model's answers to steps at time zero; delay included."""
    kept = (stored.fit_quality.get("flown_steps") or {}).get(axis) or []
    alpha = stored.values["alpha"] if stored.valid.get("voltage_v") else 0.0
    nominal_v = stored.model.nominal_voltage_v
    flown = []
    for row in kept:
        volts, answer = row.get("voltage_v"), np.asarray(row["answer"], dtype=float)
        gain = (float(volts) / nominal_v) ** alpha if volts else 1.0
        t_s = float(row["period_s"]) * np.arange(answer.size, dtype=float)
        flown.append(Wanted(float(row["size"]), t_s, answer, gain, True))
    return flown or _model_answers(stored, axis)


def _model_answers(stored: ModelFile, axis: str) -> list[Wanted]:
    model, values = stored.model, stored.values
    t: FloatArray = LOOP_S * np.arange(round(SECONDS / LOOP_S), dtype=float)
    volts = {"voltage_v": (t, np.full(t.size, model.nominal_voltage_v))}
    hover = _hover(stored)
    answers = []
    for step in STEPS[axis]:
        zero = (np.array([-1.0]), np.array([0.0]))
        u = dict.fromkeys(_REFERENCE.values(), zero) | {"throttle": (np.array([-1.0]), np.array([hover]))}
        u[_REFERENCE[axis]] = (np.array([-1.0, 0.0]), np.array([0.0, step]))
        y = np.asarray(simulate(model, values, t, {"p_z_m": 50.0}, u, volts)[_OUTPUT[axis]])
        answers.append(Wanted(step, t, y))
    return answers


def _hover(stored: ModelFile) -> float:
    return float(stored.model.hover_throttle(stored.values, stored.model.nominal_voltage_v))


def _answers(
    axis: str, loop: Loop, gain: float, lag_s: float, wanted: Sequence[Wanted], most: float
) -> list[FloatArray]:
    """The loop's answers to the same steps, at its rate from the step on and as long as the latest delay asks for."""
    found = []
    for w in wanted:
        count = round((float(w.t_s[-1]) - DELAY_S[0]) / LOOP_S) + 1
        if axis == "yaw":
            angle, rate = demanded(w.step, loop, count)
            found.append(firmware_loops.simulate_loop(loop, gain * w.gain, lag_s, angle, rate, most)[1])
        else:
            found.append(
                firmware_loops.simulate_loop(loop, gain * w.gain, lag_s, np.full(count, w.step), np.zeros(count), most)[
                    0
                ]
            )
    return found


def demanded(rate: float, loop: Loop, count: int) -> tuple[FloatArray, FloatArray]:
    """Heading rad and rate rad/s (count,) that reach the firmware's loops in a yaw rate step: the heading of `SentHeading` anew with each
    target, moved on by the rate in between."""
    sent = SentHeading(0.0, loop.accel if loop.feedforward else 0.0, 0.0 if loop.feedforward else UNSHAPED_LAG_S)
    every = round(_COMMAND_S / LOOP_S)
    angle, heading = np.empty(count), 0.0
    for k in range(count):
        if k % every == 0:
            heading = sent.next(rate, _COMMAND_S)
        angle[k] = heading + rate * LOOP_S * (k % every)
    return angle, np.full(count, rate)
