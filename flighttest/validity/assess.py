"""All the evidence to one answer: declared changes, tests on new data, drift over runs, the battery."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from flighttest.validity.battery import check_resistance
from flighttest.validity.compare import FALSE_ALARM, Estimates, MatchedPairs, subset_tests, thrust_or_mass_words
from flighttest.validity.cusum import drifts
from flighttest.validity.declared import declared_changes, same_parts, scripts_for
from flighttest.validity.hover import NAME, Hover, hover_test
from flighttest.validity.impact import impact_of
from flighttest.validity.model import (
    ALL_SCRIPTS,
    SUBSETS,
    Appeared,
    Assessment,
    BatteryCheck,
    DeclaredChange,
    Drift,
    NotSeen,
    SubsetTest,
    ValidityVerdict,
)
from flighttest.validity.motor_load import SUBSET, MotorLoad, culprit, motor_load_test
from flighttest.vehicle.fingerprint import FingerprintData

MOST_SAID = 6  # effects in the sentence; all are in the table below it
SUBSET_OF = {name: subset for subset, names in SUBSETS.items() for name in names}


@dataclass(frozen=True)
class RecordingEvidence:
    """What new recordings show of a model.

    runs: re-estimates of new runs, in time order, the last one the newest; alike: the newest one's steps against the same steps of the
    model's flights; spread: allowed relative change by parameter. battery: (Ohm, std) of the newest run, or why it cannot be determined;
    battery_reference: of the model's flights. hovers, motors: the throttle that holds height, and how the motors share the load, of the
    model's flights and of the newest run.
    untestable: what could not be tested, one sentence each; appeared: effects that the model does not have; doubtful: a mismatch that may
    be such an effect or gusts, in a sentence; not_seen: effects that neither side has, none where they were not looked for.
    """

    runs: Sequence[Estimates] = ()
    matched: MatchedPairs | None = None
    spread: Mapping[str, float] | None = None
    battery: tuple[float, float] | str | None = None
    battery_reference: tuple[float, float] | None = None
    hovers: tuple[Hover | None, Hover | None] = (None, None)
    motors: tuple[MotorLoad | None, MotorLoad | None] = (None, None)
    untestable: Sequence[str] = ()
    appeared: Sequence[Appeared] = ()
    doubtful: str = ""
    not_seen: Sequence[NotSeen] = ()


def assess(
    *,
    model_fingerprint: FingerprintData,
    vehicle_fingerprint: FingerprintData | None,
    stored: Estimates,
    new: RecordingEvidence | None = None,
    subsets: Mapping[str, tuple[str, ...]] = SUBSETS,
) -> Assessment:
    """Is the model still valid?

    model_fingerprint, vehicle_fingerprint: as in model.yaml; None when nothing is known of today's vehicle. stored: the model's
    estimates; new: what recordings since then show; subsets: parameters that are tested together.
    """
    new = new or RecordingEvidence()
    runs, matched, appeared = new.runs, new.matched, new.appeared
    changes: tuple[DeclaredChange, ...] = ()
    cannot_tell = list(new.untestable)
    if vehicle_fingerprint is not None:
        changes, unknown = declared_changes(model_fingerprint, vehicle_fingerprint)
        cannot_tell += unknown
    tests = _tests(stored, new, subsets)
    drift = drifts(stored, runs, new.spread) if len(runs) > 1 else ()
    checked = check_resistance(new.battery, new.battery_reference) if new.battery is not None else None
    alarms = [t for t in tests if t.alarm]
    crossed = [d for d in drift if d.crossed_at]
    compared = _same_parameters(model_fingerprint, vehicle_fingerprint) if vehicle_fingerprint is not None else ""
    fly: tuple[str, ...] = ()
    narrow: tuple[str, ...] = ()
    if changes or alarms or crossed or appeared:
        verdict = ValidityVerdict.STALE
        sides = (matched.before, matched.after) if matched is not None else (stored, runs[-1]) if runs else None
        sentence = _stale(changes, alarms, crossed, tests, sides, appeared)
        if changes or alarms or crossed or not all(a.unseen for a in appeared):
            fly, narrow = ALL_SCRIPTS, _narrow(changes, alarms, crossed)
    elif new.doubtful:
        verdict, sentence, fly = ValidityVerdict.UNKNOWN, _doubtful(new.doubtful), ("spot_check",)
    elif tests or (vehicle_fingerprint is not None and same_parts(model_fingerprint, vehicle_fingerprint)):
        verdict, sentence = ValidityVerdict.CURRENT, _current(tests, bool(cannot_tell), compared, new.not_seen)
    else:
        verdict, sentence = ValidityVerdict.UNKNOWN, _unknown(compared)
    return Assessment(
        verdict=verdict,
        sentence=sentence + _of_battery(checked),
        changes=changes,
        tests=tests,
        drifts=drift,
        battery=checked,
        impact=impact_of(changes, alarms),
        fly=fly,
        fly_narrow=narrow,
        could_also_be=_rivals(alarms),
        cannot_tell=tuple(dict.fromkeys(cannot_tell)),
        appeared=tuple(appeared),
        not_seen=tuple(new.not_seen),
    )


def _tests(stored: Estimates, new: RecordingEvidence, subsets: Mapping[str, tuple[str, ...]]) -> tuple[SubsetTest, ...]:
    """Every test of the newest run against the model. The false-alarm rate of all together stays `FALSE_ALARM`."""
    before, now = new.motors
    tests = _tests_of_motion(stored, new, subsets, FALSE_ALARM)
    if before is None or now is None:
        return tests
    shared = FALSE_ALARM / (len(tests) + 1)
    others = _tests_of_motion(stored, new, subsets, shared * len(tests)) if tests else ()
    return (*others, motor_load_test(before, now, shared))


def _tests_of_motion(
    stored: Estimates, new: RecordingEvidence, subsets: Mapping[str, tuple[str, ...]], level: float
) -> tuple[SubsetTest, ...]:
    """The newest run's estimates against the model's, by subset; the throttle that holds height in the place of the thrust's test, or
    beside the others, where it would show the smaller change. level: false-alarm rate of these together."""
    runs, before, now = new.runs, *new.hovers

    def by_estimates(false_alarm: float = level) -> tuple[SubsetTest, ...]:
        return subset_tests(
            stored, runs[-1], spread=new.spread, false_alarm=false_alarm, matched=new.matched, subsets=subsets
        )

    tests = by_estimates() if runs else ()
    if before is None or now is None:
        return tests
    alpha = stored.known.values[stored.known.names.index("alpha")] if "alpha" in stored.known.names else None
    by_gain = next((t for t in tests if t.subset == "thrust" and "K" in t.shifts), None)
    others = tuple(t for t in tests if t is not by_gain)
    shared = level / (len(others) + 1)
    by_level = hover_test(before, now, alpha, shared)
    if by_gain is None:
        return (*(by_estimates(shared * len(others)) if others else ()), by_level)
    return (*others, by_level) if by_gain.detectable.get("K", 0.0) > by_level.detectable[NAME] else tests


def _narrow(
    changes: Sequence[DeclaredChange], alarms: Sequence[SubsetTest], crossed: Sequence[Drift]
) -> tuple[str, ...]:
    """The scripts for what has changed alone; all where that is of no one subset."""
    moved = {s for c in changes for s in c.touches} | {t.subset for t in alarms}
    moved |= {SUBSET_OF[d.parameter] for d in crossed if d.parameter in SUBSET_OF}
    return scripts_for(tuple(s for s in SUBSETS if s in moved)) or ALL_SCRIPTS


def _same_parameters(model: FingerprintData, vehicle: FingerprintData) -> str:
    """What was compared where both sides hold their parameters, in words."""
    count = len(set(model.get("shaping_parameters") or ()) & set(vehicle.get("shaping_parameters") or ()))
    return (
        f"{'firmware and ' if model.get('firmware') else ''}the {count} parameters that shape the response"
        if count
        else ""
    )


def _of_battery(checked: BatteryCheck | None) -> str:
    """The battery's own alarm: it leaves the model as it is, so that the verdict stays."""
    if checked is None or not checked.alarm:
        return ""
    return f" The battery is not what it was: {checked.sentence}; the model allows for it wherever the loaded voltage is measured."


def _unknown(compared: str) -> str:
    if compared:
        return (
            f"Unknown: {compared} are what they were when the model was flown; whether its components are, only vehicle.yaml can state "
            "(--vehicle), or the spot check."
        )
    return "Unknown: nothing was given that shows whether the model still holds; declare the components, or fly the spot check."


def _doubtful(mismatch: str) -> str:
    return (
        f"Unknown: {mismatch[:1].lower() + mismatch[1:].rstrip('.')}. It may be an effect that the model does not have, or gusts: "
        "no step was flown twice. Fly the spot check again, and give both recordings to `flighttest status`."
    )


def _current(tests: Sequence[SubsetTest], in_part: bool, compared: str, not_seen: Sequence[NotSeen]) -> str:
    if not tests:
        limit = "; what could not be compared is below, and the spot check would show it" if in_part else ""
        matched = f"; {compared} are what they were" if compared else ""
        return f"Current: nothing that is declared has changed since the model was flown{matched}{limit}."
    determined = list(dict.fromkeys(t.subset for t in tests))
    blind = [s for s in SUBSETS if s not in determined]
    nothing = f"; on {', '.join(blind)} it, or the model's own recordings, contain no information" if blind else ""
    return (
        f"Current: the new recording agrees with the model in {', '.join(determined)}{nothing}.{_of_effects(not_seen)}"
    )


def _of_effects(not_seen: Sequence[NotSeen]) -> str:
    """How far new effects are ruled out."""
    if not not_seen:
        return ""
    hidden = [e.term for e in not_seen if e.hidden]
    names = f": {', '.join(hidden)}" if len(hidden) <= MOST_SAID else ""
    unseen = f"; {len(hidden)} of them could be there unseen at twice the usual size{names}" if hidden else ""
    return f" It shows none of {len(not_seen)} effects that the model does not have{unseen}."


def _stale(
    changes: Sequence[DeclaredChange],
    alarms: Sequence[SubsetTest],
    crossed: Sequence[Drift],
    tests: Sequence[SubsetTest],
    sides: tuple[Estimates, Estimates] | None,
    appeared: Sequence[Appeared],
) -> str:
    parts = []
    if changes:
        named = [f"{c.name} ({c.before} is now {c.after})" for c in changes[:3]]
        more = f" and {len(changes) - 3} more" if len(changes) > 3 else ""
        parts.append(f"changed since the model was flown: {', '.join(named)}{more}")
    if alarms:
        moved = {t.subset for t in alarms}
        still = list(dict.fromkeys(t.subset for t in tests if t.subset not in moved))
        words = "; ".join(t.sentence for t in alarms)
        words += f"; {', '.join(still)} as before" if still else ""
        parts.append(words + _culprit(alarms, sides, tests))
    new, unseen = _names(a for a in appeared if not a.unseen), _names(a for a in appeared if a.unseen)
    if new:
        parts.append(f"the new recording shows what the model does not have: {new}")
    if unseen:
        parts.append(
            f"the new recording shows what the model lacks: {unseen}. Its own flights could not have shown that, so nothing need have "
            "changed on the vehicle; diagnose this recording together with those flights, and accept the model that comes out"
        )
    if crossed and not alarms:
        parts.append(
            "slow drift: "
            + ", ".join(
                f"{d.parameter} {d.change * 100:+.1f} % by now, beyond chance in {d.crossed_at}" for d in crossed
            )
        )
    later = [part[:1].upper() + part[1:] for part in parts[1:]]
    return f"Stale: {'. '.join([*parts[:1], *later])}."


def _names(appeared: Iterable[Appeared]) -> str:
    return ", ".join(a.title[:1].lower() + a.title[1:] for a in appeared)


def _drag_would_show(alarms: Sequence[SubsetTest], tests: Sequence[SubsetTest]) -> bool:
    """Whether drag, which more mass divides as it does thrust, was tested for a change as large as that of thrust."""
    change = max((abs(t.shifts["K"][0]) for t in alarms if "K" in t.shifts), default=0.0)
    return any(least < change for t in tests if t.subset == "drag" for least in t.detectable.values())


def _culprit(
    alarms: Sequence[SubsetTest], sides: tuple[Estimates, Estimates] | None, tests: Sequence[SubsetTest]
) -> str:
    moved = {t.subset for t in alarms}
    if _lag_alone(alarms):
        return (
            ": what delays the thrust (motors, speed controllers, a throttle filter), and not how much of it there is"
        )
    if (motors := next((t for t in alarms if t.subset == SUBSET), None)) is not None:
        return f": {culprit(motors)}"
    if "thrust" in moved and "attitude" not in moved:
        known = sides is not None and _drag_would_show(alarms, tests)
        what = thrust_or_mass_words(*sides) if sides is not None and known else "thrust or mass"
        words = {
            "thrust or mass": "less or more thrust (propellers, motors, battery), or another mass: this flight cannot distinguish them",
            "thrust": "propellers, motors or battery, and not the mass",
            "mass": "the mass, and not the propellers",
        }[what]
        return f": {words}"
    if moved == {"attitude"}:
        return ": the attitude loops (gains, filters, propellers' inertia), and not the thrust"
    if moved == {"yaw"}:
        return ": the yaw loop, and nothing else"
    return ""


def _lag_alone(alarms: Sequence[SubsetTest]) -> bool:
    """Whether of the thrust only the lag has moved."""
    thrust = next((t for t in alarms if t.subset == "thrust"), None)
    return thrust is not None and "K" in thrust.shifts and abs(thrust.shifts["K"][1]) < abs(_z(thrust, "sigma_t")) / 2.0


def _z(test: SubsetTest, parameter: str) -> float:
    return test.shifts[parameter][1] if parameter in test.shifts else 0.0


def _rivals(alarms: Sequence[SubsetTest]) -> tuple[str, ...]:
    found = []
    moved = {t.subset for t in alarms}
    if "thrust" in moved and not _lag_alone(alarms):
        found += [
            "another mass (weigh it)",
            "air density (10 °C or 300 m: 3 %)",
        ]
    if "motors" in moved:
        found.append("another centre of mass (a load, or the battery in another place)")
    if "drag" in moved:
        found.append("steady wind, unless all headings were flown")
    if "attitude" in moved:
        found.append("a slower link, in part: compare the delays")
    return tuple(found)
