"""What a change of parameters means for a plan made with the model, in everyday quantities."""

from __future__ import annotations

from collections.abc import Sequence

from flighttest.frames import G_M_S2
from flighttest.validity.hover import NAME
from flighttest.validity.model import SUBSETS, WORDS, DeclaredChange, SubsetTest


def impact_of(changes: Sequence[DeclaredChange], alarms: Sequence[SubsetTest]) -> tuple[str, ...]:
    """One sentence per subset that moved; what a declared change puts in doubt that no flight has tested yet."""
    found = [sentence for test in alarms if (sentence := _of_test(test))]
    determined = {test.subset for test in alarms}
    doubtful = [s for s in SUBSETS if s not in determined and any(s in c.touches for c in changes)]
    if doubtful:
        names = ", ".join(n for s in doubtful for n in SUBSETS[s])
        found.append(
            f"until it is flown again, {names} of the model may be wrong, and so may every plan made with them"
        )
    return tuple(found)


def _of_test(test: SubsetTest) -> str:
    name = max(test.shifts, key=lambda n: abs(test.shifts[n][1]))
    change = test.shifts[name][0]
    if not -0.9 < change < 9.0:
        return ""
    if name in ("K", NAME):
        gain = change if name == "K" else 1.0 / (1.0 + change) - 1.0
        way = "climbs" if gain > 0 else "sinks"
        return (
            f"at the throttle that held height it now {way} with {G_M_S2 * abs(gain):.1f} m/s²: {0.5 * G_M_S2 * abs(gain):.2f} m "
            "within one second, which a plan made with this model does not expect"
        )
    slower = 1.0 / (1.0 + change) - 1.0
    much = f"{abs(slower) * 100:.0f} % {'longer' if slower > 0 else 'shorter'}"
    if name.startswith("omega") or name == "sigma_r":
        what = "a turn" if name == "sigma_r" else "a tilt"
        return f"{what} takes {much} to arrive than a plan made with this model expects"
    if name.startswith("zeta"):
        return f"a tilt overshoots {'less' if change > 0 else 'more'} than in the model: damping {change * 100:+.0f} %"
    if name == "sigma_t":
        return f"thrust takes {much} to come than in the model"
    if name.startswith("d_"):
        return f"drag is {change * 100:+.0f} % of the model's: the speed at which a tilt settles is off by as much"
    if name.startswith("T_d"):
        return f"the {WORDS.get(name, name)} is {change * 100:+.0f} % of the model's: a plan made with it acts too early or too late"
    if name.startswith("motor_"):
        return f"{name.replace('_', ' ')} reaches its limit earlier than in the model's flights" if change > 0 else ""
    if name == "alpha":
        return f"what a throttle gives at another voltage is off: alpha {change * 100:+.0f} %"
    return f"{name} of {test.subset} is {change * 100:+.0f} % of the model's: what it stands for is predicted wrong by as much"
