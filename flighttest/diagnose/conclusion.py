"""The conclusion of a diagnosis in words: verdict, sentence, notes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from flighttest.diagnose.model import EXPLAINED_SHARE, Finding, Located, TermVerdict, Verdict, channel_words
from flighttest.diagnose.records import HeldOutRow, ParameterRow
from flighttest.diagnose.residuals.lack_of_fit import SIGNIFICANCE
from flighttest.estimation.drift import DISTURBANCE_DRIFT
from flighttest.estimation.uncertainty.distributions import fisher_beyond
from flighttest.physics.body import DELAY_PARAM
from flighttest.physics.catalogue import catalogue
from flighttest.physics.model import ROTOR_HEIGHT_M

DELAYS_DIFFER_S = 0.01
BY_TIME, BY_HEIGHT = "time_since_takeoff_s", "height_m"
COMPENSATED = 0.5  # alpha below which thrust does not follow the voltage as motors on a battery do
# A base parameter that came out so far from the model given (of its value, and of the standard error of the difference) is reported.
MOVED, MOVED_ERRORS = 0.05, 4.0
UNMOVED = "these flights do not move what it acts on"
UNTRIED = "not looked for to the end: the search was interrupted"


def verdict_of(*, named: bool, located: bool, unexplained: bool) -> Verdict:
    """The answer as a whole: whether anything is named, is located without what is named or carries the vehicle beside the model, stays
    unexplained in a channel with it."""
    if not named:
        return Verdict.UNKNOWN_PHYSICS if located else Verdict.NOTHING_MISSING
    return Verdict.PARTLY if unexplained else Verdict.EXPLAINED


def sentence_of(
    verdict: Verdict, findings: Sequence[Finding], left: tuple[float, str], located: Sequence[Located], complete: bool
) -> str:
    """The answer in one sentence. left: share of the error that stays, and which error."""
    share, error = left
    if not complete and verdict is Verdict.NOTHING_MISSING:
        return "Interrupted: nothing was found missing until then. Effects that were not searched may be missing."
    more = "" if complete else " Interrupted: there may be more."
    names = ", ".join(_name(f) for f in findings)
    if verdict is Verdict.EXPLAINED:
        gone = 100 * max(0.0, 1 - share)
        much = f"{gone:.0f}" if round(gone) else "less than 1"  # most of what gusts and noise do is no model's
        it = "it" if len(findings) == 1 else "them"
        return f"The base model lacks: {names}. Adding {it} removes {much} % of the {error}.{more}"
    if verdict is Verdict.PARTLY:
        return f"The base model lacks: {names}. {100 * share:.0f} % of the {error} remains unexplained.{more}"
    if verdict is Verdict.NOTHING_MISSING:
        return (
            "Nothing is missing above the noise floor. The smallest effects that would have been detected are listed."
        )
    determined = (
        f"Something is missing that no effect of the catalogue explains. Its place: {located[0].sentence}."
        if located
        else verdict.value
    )
    return determined + more


def _name(finding: Finding) -> str:
    """The title of a finding, with what would explain the recordings as well."""
    others = [catalogue()[r.term].title.lower() for r in finding.rivals if r.verdict is TermVerdict.CONFUSABLE]
    rest = f" (or {' or '.join(others)}: these recordings do not distinguish them)" if others else ""
    return finding.title.lower() + rest


def moved_parameters(previous: Mapping[str, tuple[float, float | None]], after: Mapping[str, ParameterRow]) -> str:
    """What the refit of the base has taken up: parameters that are no longer those of the model given."""
    changes = {}
    for name in (n for n in previous if n in after and not n.startswith("T_d")):
        old, std = previous[name]
        difference = float(after[name]["value"]) - old
        error = float(np.hypot(float(after[name]["scatter"]), std or 0.0))
        if old and abs(difference) > max(MOVED * abs(old), MOVED_ERRORS * error):
            changes[name] = difference / abs(old)
    if not changes:
        return ""
    largest = sorted(changes, key=lambda n: -abs(changes[n]))
    words = ", ".join(f"{n} {100 * changes[n]:+.0f} %" for n in largest[:3])
    more = f" and {len(largest) - 3} more" if len(largest) > 3 else ""
    return f" Parameters of the given model changed in the new fit ({words}{more})."


def predicted_worse(held: Mapping[str, Mapping[str, HeldOutRow]]) -> str:
    """Channels (short) that the model with what is named predicts worse, of responses not used, above the noise floor: surely, where the
    95 % interval of the drop in RMSE is below zero; else where the error is larger by more than what may stay of one that is explained."""
    said = []
    for channel, rows in held.items():
        row = rows["all"]
        ratio, surely = row["rmse_after"] / max(row["rmse_before"], 1e-300), row["gain_95"][1] < 0.0
        shown = _per_cent(ratio) > 0.0 if surely else ratio > 1.0 + EXPLAINED_SHARE
        if row["rmse_after"] > row["floor"] and shown:
            said.append(f"{channel_words(channel)} ({_larger(ratio)}{'' if surely else ', which may be chance'})")
    return f" On data not used it predicts worse than the base model: {', '.join(said)}." if said else ""


def _per_cent(ratio: float) -> float:
    """What a ratio is more than one, per cent, as finely as it is printed."""
    more = 100.0 * (ratio - 1.0)
    return round(more, 0 if more >= 1.0 else 1)


def _larger(ratio: float) -> str:
    return f"{ratio:.2g} times the error" if ratio >= 2.0 else f"{_per_cent(ratio):g} % more error"


def carried_otherwise(table: Mapping[str, ParameterRow]) -> str:
    """That thrust by the throttle does not carry the vehicle, in a sentence; empty where it does. K follows from hovering alone; at its
    bound, the disturbances that each window has of its own carried the weight, and no mismatch is left to see."""
    gain = table.get("K")
    if gain is None or not gain.get("at_bound"):
        return ""
    return (
        f"K is at its bound ({float(gain['value']):.3g} m/s^2): thrust by this throttle does not carry the vehicle, so that nothing can be "
        "said of what is missing. Is it the throttle of these motors, in the right unit, and did the vehicle fly freely?"
    )


def different_delays(table: Mapping[str, ParameterRow]) -> list[str]:
    """Channel delays that differ: the model has one per channel, so this needs no term."""
    known = {
        n: (float(table[n]["value"]), float(table[n]["scatter"]))
        for n in DELAY_PARAM.values()
        if n in table and not table[n].get("at_bound")
    }
    if len(known) < 2:
        return []
    (late, (most, most_std)), (early, (least, least_std)) = (
        max(known.items(), key=lambda kv: kv[1][0]), min(known.items(), key=lambda kv: kv[1][0])
    )  # fmt: skip
    if most - least < DELAYS_DIFFER_S or most - least < 4 * float(np.hypot(most_std, least_std)):
        return []
    return [
        f"channel_delay: {late} is {1000 * (most - least):.0f} ms longer than {early}; the model has a delay for each channel, "
        "so that no further term is needed"
    ]


def unlike_flights(pushes: Mapping[str, NDArray[np.float64]]) -> str:
    """That flights differ as a whole, in a sentence; empty where they do not. pushes: flight to the constant vertical disturbances of its
    windows, m/s^2 (n,).

    One-way analysis of variance, against flights between which accelerometers drift. The disturbance of each window is part of the noise of
    free flight, so that flights that differ leave no mismatch behind.
    """
    each = {flight: values for flight, values in pushes.items() if values.size}
    flights, windows = len(each), sum(values.size for values in each.values())
    if flights < 2 or windows <= flights:
        return ""
    middle = {flight: float(values.mean()) for flight, values in each.items()}
    mean = sum(v.size * middle[f] for f, v in each.items()) / windows
    between = sum(v.size * (middle[f] - mean) ** 2 for f, v in each.items()) / (flights - 1)
    within = sum(float(np.sum((v - middle[f]) ** 2)) for f, v in each.items()) / (windows - flights)
    usual = within + windows / flights * DISTURBANCE_DRIFT["a_d_z_m_s2"] ** 2
    if fisher_beyond(between / usual, flights - 1, windows - flights) >= SIGNIFICANCE:
        return ""
    least, most = min(middle, key=lambda f: middle[f]), max(middle, key=lambda f: middle[f])
    return (
        f" This holds within flights, and these differ: the vertical acceleration of each is off as a whole, from {middle[least]:+.2g} "
        f"m/s^2 ({least}) to {middle[most]:+.2g} ({most}), and that of its windows by {np.sqrt(within):.2g} beside it. Another vehicle, "
        "load, propeller or battery looks like this, and these recordings do not determine which: diagnose flights that have them in "
        "common apart from the others."
    )


def unrecorded_battery(located: Sequence[Located], recorded: bool) -> list[str]:
    """Where a vertical error falls with the time since take-off and no voltage was recorded: a battery that runs down looks like that, and
    no term can be compared with it. An error that rises is none of a battery's."""
    late = [
        place.channel
        for place in located
        if place.regime.get("variable") == BY_TIME and place.channel.endswith("_z") and place.peak < 0.0
    ]
    if recorded or not late:
        return []
    return [
        f"battery: the error of {', '.join(dict.fromkeys(late))} depends on the time since take-off, and no battery voltage was recorded: "
        "a battery that runs down looks like this; record its voltage"
    ]


def rotor_height_taken(located: Sequence[Located], named: Sequence[str], rotor_height_m: float) -> list[str]:
    """Where more lift near the ground has no name, and the height of the rotors is the usual one, not this vehicle's."""
    low = any(p.regime.get("variable") == BY_HEIGHT and "below" in p.regime and p.peak > 0.0 for p in located)
    if not low or "ground_effect" in named or rotor_height_m != ROTOR_HEIGHT_M:
        return []
    return [
        f"ground effect: more lift near the ground has no name; the rotors were taken to be {rotor_height_m:g} m above the recorded "
        "height, and those of a small vehicle are lower: give rotor_height_m in the vehicle file, less what the height reads on the ground"
    ]


def compensated_voltage(table: Mapping[str, ParameterRow]) -> list[str]:
    """Thrust that does not follow the voltage: somebody makes up for it, and it is no physics of the vehicle."""
    alpha = table.get("alpha")
    if alpha is None or float(alpha["value"]) + 2 * float(alpha["std"]) > COMPENSATED:
        return []
    return [
        f"battery compensation: alpha is {float(alpha['value']):.2f} ± {1.96 * float(alpha['std']):.2f}, where motors on a battery have 1 "
        "to 2: the autopilot makes up for the voltage (ArduPilot MOT_BAT_VOLT_MAX), or the ESCs hold the rotor speed"
    ]


def pushed_once(count: int) -> str:
    """How many responses were set aside, in a sentence."""
    many = (
        "1 response that something pushed once is"
        if count == 1
        else f"{count} responses that something pushed once are"
    )
    return f"{many} set aside."
