"""The tests of currency: their false alarms are as stated, and they see what they claim to see."""

import numpy as np
import pytest

from flighttest.currency import battery, compare, sequence
from flighttest.currency.compare import DISCREPANCY, Estimates

NAMES = ("omega_phi", "omega_theta", "zeta_phi", "zeta_theta", "sigma_r", "sigma_t", "K", "alpha", "d_x", "d_y", "d_z")
TRUTH = np.array([25.43, 23.40, 0.44, 0.39, 21.54, 20.36, 54.55, 1.71, 0.39, 0.39, 0.51])
RELATIVE = np.array([0.004, 0.004, 0.008, 0.008, 0.01, 0.01, 0.003, 0.03, 0.05, 0.05, 0.03])


def campaign(rng, name="run", factor=None):
    """Estimates of one campaign of a vehicle whose campaigns scatter as DISCREPANCY says, K and alpha correlated."""
    own = np.diag((RELATIVE * TRUTH) ** 2)
    i, j = NAMES.index("K"), NAMES.index("alpha")
    own[i, j] = own[j, i] = 0.8 * np.sqrt(own[i, i] * own[j, j])
    floor = np.diag((np.array([DISCREPANCY[n] for n in NAMES]) * TRUTH) ** 2 / 2)  # half on either side
    truth = TRUTH * (1.0 if factor is None else factor)
    return Estimates(name, NAMES, rng.multivariate_normal(truth, own + floor), own)


def changed(**factors):
    return np.array([factors.get(n, 1.0) for n in NAMES])


def test_false_alarms_per_campaign_are_as_stated():
    rng = np.random.default_rng(1)
    alarms = sum(any(t.alarm for t in compare.subset_tests(campaign(rng), campaign(rng))) for _ in range(1500))
    assert 3 <= alarms <= 30, alarms / 1500  # stated: 1 %, 15 of 1500


@pytest.mark.parametrize(
    ("factor", "subset"),
    [
        (changed(K=0.95), "thrust"),
        (changed(K=1 / 1.08, d_x=1 / 1.08, d_y=1 / 1.08, d_z=1 / 1.08), "thrust"),
        (changed(omega_phi=0.8, omega_theta=0.8), "attitude"),
    ],
)
def test_the_wanted_changes_are_seen_and_placed(factor, subset):
    rng = np.random.default_rng(2)
    found = placed = 0
    for _ in range(100):
        tests = compare.subset_tests(campaign(rng), campaign(rng, factor=factor))
        alarms = [t.subset for t in tests if t.alarm]
        found += bool(alarms)
        placed += alarms == [subset]
    assert found >= 95
    assert placed >= 90


def test_the_sentence_names_what_moved():
    rng = np.random.default_rng(3)
    tests = compare.subset_tests(campaign(rng), campaign(rng, factor=changed(K=0.90)))
    thrust = next(t for t in tests if t.subset == "thrust")
    assert "thrust per throttle fell" in thrust.sentence
    assert next(t for t in tests if t.subset == "yaw").sentence == "yaw: as before"


def test_thrust_or_mass_is_one_answer_unless_drag_is_known():
    rng = np.random.default_rng(4)
    stored, new = campaign(rng), campaign(rng, factor=changed(K=0.93))
    assert compare.thrust_or_mass(stored, new) == "thrust or mass"
    sharp = np.diag((0.002 * TRUTH) ** 2)
    lighter = changed(K=0.93, d_x=0.93, d_y=0.93, d_z=0.93)
    assert (
        compare.thrust_or_mass(Estimates("a", NAMES, TRUTH, sharp), Estimates("b", NAMES, TRUTH * lighter, sharp))
        == "mass"
    )
    assert (
        compare.thrust_or_mass(
            Estimates("a", NAMES, TRUTH, sharp), Estimates("b", NAMES, TRUTH * changed(K=0.93), sharp)
        )
        == "thrust"
    )


def test_run_length_is_the_textbooks():
    # Montgomery, Introduction to Statistical Quality Control: two-sided, k = 0.5, h = 5: 465; h = 4: 168.
    assert sequence.mean_run_length(0.5, 5.0) == pytest.approx(465, rel=0.03)
    assert sequence.mean_run_length(0.5, 4.0) == pytest.approx(168, rel=0.03)


def test_slow_drift_is_caught_and_no_drift_is_not():
    rng = np.random.default_rng(5)
    still = [campaign(rng, f"run{i}") for i in range(20)]
    assert sum(bool(d.crossed_at) for d in sequence.drifts(campaign(rng), still)) <= 1
    worn = [campaign(rng, f"run{i}", changed(K=1 - 0.005 * i)) for i in range(20)]
    drift = next(d for d in sequence.drifts(campaign(rng), worn) if d.parameter == "K")
    assert drift.crossed_at
    assert drift.excursion < 0


def pack(rng, ohm, seconds=300.0):
    t = np.arange(0.0, seconds, 0.1)
    current = 25 + 8 * np.sign(np.sin(2 * np.pi * t / 3.0)) + rng.normal(0, 0.5, t.size)
    voltage = 24.5 - 2.0 * t / seconds - ohm * current + rng.normal(0, 0.02, t.size)
    return t, voltage, current


def test_battery_resistance_and_its_alarm():
    rng = np.random.default_rng(6)
    fresh = battery.resistance(*pack(rng, 0.030))
    assert isinstance(fresh, tuple)
    assert fresh[0] == pytest.approx(0.030, abs=4 * fresh[1] + 2e-4)
    aged = battery.resistance(*pack(rng, 0.036))
    assert battery.check(aged, fresh).alarm
    again = battery.resistance(*pack(rng, 0.030))
    assert not battery.check(again, fresh).alarm


def test_battery_without_current_is_untestable_by_name():
    t = np.arange(0.0, 100.0, 0.1)
    silent = np.full(t.size, np.nan)
    found = battery.check(battery.resistance(t, np.full(t.size, 23.0), silent), (0.03, 0.001))
    assert "UNTESTABLE" in found.sentence
    assert not found.alarm
