"""The tests of validity: their false alarms are as stated, and they see what they claim to see."""

import numpy as np
import pytest

from flighttest.estimation.likelihood_weights import Normal
from flighttest.pipeline.recordings.batteries import battery_of
from flighttest.recording import Provenance, Recording, Series
from flighttest.segments import Segment
from flighttest.validity import battery, compare, cusum
from flighttest.validity.assess import RecordingEvidence, assess
from flighttest.validity.between_campaigns import measured, prior
from flighttest.validity.compare import FALSE_ALARM, Estimates, MatchedPairs, subset_tests
from flighttest.validity.hover import hover, hover_test
from flighttest.validity.model import ValidityVerdict

NAMES = ("omega_phi", "omega_theta", "zeta_phi", "zeta_theta", "sigma_r", "sigma_t", "K", "alpha", "d_x", "d_y", "d_z")
TRUTH = np.array([25.43, 23.40, 0.44, 0.39, 21.54, 20.36, 54.55, 1.71, 0.39, 0.39, 0.51])
RELATIVE = np.array([0.004, 0.004, 0.008, 0.008, 0.01, 0.01, 0.003, 0.03, 0.05, 0.05, 0.03])


def campaign(rng, name="run", factor=None):
    """Estimates of one campaign of a vehicle whose campaigns scatter as the prior has it, K and alpha correlated."""
    own = np.diag((RELATIVE * TRUTH) ** 2)
    i, j = NAMES.index("K"), NAMES.index("alpha")
    own[i, j] = own[j, i] = 0.8 * np.sqrt(own[i, i] * own[j, j])
    floor = np.diag((np.array([prior(n) for n in NAMES]) * TRUTH) ** 2 / 2)  # half on either side
    truth = TRUTH * (1.0 if factor is None else factor)
    return Estimates(name, NAMES, rng.multivariate_normal(truth, own + floor), own)


def changed(**factors):
    return np.array([factors.get(n, 1.0) for n in NAMES])


@pytest.mark.slow
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
    assert compare.thrust_or_mass_words(stored, new) == "thrust or mass"
    unsure = np.diag((np.array([0.015 if n.startswith("d_") else 0.002 for n in NAMES]) * TRUTH) ** 2)
    little = changed(K=0.975, d_x=0.987, d_y=0.987, d_z=0.987)
    sides = Estimates("a", NAMES, TRUTH, unsure / 2), Estimates("b", NAMES, TRUTH * little, unsure / 2)
    assert compare.thrust_or_mass_words(*sides) == "thrust or mass", "drag within its error of both"
    sharp = np.diag((0.002 * TRUTH) ** 2)
    lighter = changed(K=0.93, d_x=0.93, d_y=0.93, d_z=0.93)
    assert (
        compare.thrust_or_mass_words(Estimates("a", NAMES, TRUTH, sharp), Estimates("b", NAMES, TRUTH * lighter, sharp))
        == "mass"
    )
    assert (
        compare.thrust_or_mass_words(
            Estimates("a", NAMES, TRUTH, sharp), Estimates("b", NAMES, TRUTH * changed(K=0.93), sharp)
        )
        == "thrust"
    )


def test_run_length_is_the_textbooks():
    # Montgomery, Introduction to Statistical Quality Control: two-sided, k = 0.5, h = 5: 465; h = 4: 168.
    assert cusum.mean_run_length(0.5, 5.0) == pytest.approx(465, rel=0.03)
    assert cusum.mean_run_length(0.5, 4.0) == pytest.approx(168, rel=0.03)


def test_slow_drift_is_caught_and_no_drift_is_not():
    rng = np.random.default_rng(5)
    still = [campaign(rng, f"run{i}") for i in range(20)]
    assert sum(bool(d.crossed_at) for d in cusum.drifts(campaign(rng), still)) <= 1
    worn = [campaign(rng, f"run{i}", changed(K=1 - 0.005 * i)) for i in range(20)]
    drift = next(d for d in cusum.drifts(campaign(rng), worn) if d.parameter == "K")
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
    assert battery.check_resistance(aged, fresh).alarm
    again = battery.resistance(*pack(rng, 0.030))
    assert not battery.check_resistance(again, fresh).alarm


def test_battery_without_current_is_untestable_by_name():
    t = np.arange(0.0, 100.0, 0.1)
    silent = np.full(t.size, np.nan)
    found = battery.check_resistance(battery.resistance(t, np.full(t.size, 23.0), silent), (0.03, 0.001))
    assert "UNTESTABLE" in found.sentence
    assert not found.alarm


def test_all_parameters_together_raise_as_few_false_alarms_as_stated():
    rng = np.random.default_rng(15)
    crossed = 0
    for _ in range(40):
        runs = [campaign(rng, f"run{i}") for i in range(20)]
        crossed += any(d.crossed_at for d in cusum.drifts(campaign(rng), runs))
    assert crossed <= 10, "stated: one in 200 runs, four in 800"


def test_thrust_is_compared_at_the_voltage_flown():
    """Two campaigns that agree on the thrust at 0.9 U_n and on nothing else about K and alpha: only that flight's voltage determines it."""
    there = float(np.log(0.9))
    values = np.array([50.0, 1.7])
    stored = Estimates("model", ("K", "alpha"), values, np.diag((np.array([0.002, 0.1]) * values) ** 2), None, 0.0)
    ridge = np.array([50.0 * 0.9**-0.3, 2.0])  # more alpha, and a K that gives the same at 0.9 U_n
    blur = np.outer([-ridge[0] * there, 1.0], [-ridge[0] * there, 1.0]) * 0.3**2 + np.diag(
        [(0.003 * ridge[0]) ** 2, 1e-6]
    )
    new = Estimates("run", ("K", "alpha"), ridge, blur, None, there)
    shift = compare.subset_tests(stored, new)[0].shifts["K"][0]
    assert shift == pytest.approx(0.0, abs=1e-9)
    weaker = Estimates("run", ("K", "alpha"), ridge * [0.93, 1.0], blur, None, there)
    test = compare.subset_tests(stored, weaker, spread={"K": 0.004, "alpha": 0.02})[0]
    assert test.shifts["K"][0] == pytest.approx(-0.07, abs=1e-9)
    # The same flight with alpha held at the model's: K alone comes out, at the nominal voltage.
    held = Estimates("run", ("K",), np.array([50.0 * 0.93]), np.array([[(0.003 * 50.0) ** 2]]), None, there)
    sharp = Estimates("model", ("K", "alpha"), values, np.diag((np.array([0.002, 0.02]) * values) ** 2), None, 0.0)
    assert compare.subset_tests(sharp, held, spread={"K": 0.004, "alpha": 0.02})[0].alarm
    vague = Estimates("model", ("K", "alpha"), values, np.diag((np.array([0.002, 0.5]) * values) ** 2), None, 0.0)
    test = compare.subset_tests(vague, held, spread={"K": 0.004, "alpha": 0.02})[0]
    assert not test.alarm, "the model does not determine what its throttle gives at that voltage"


@pytest.mark.slow
def test_few_responses_raise_no_more_false_alarms():
    rng = np.random.default_rng(16)
    alarms = 0
    for _ in range(2000):
        rows = rng.normal(size=(2, 5))  # five responses on either side determine their own scatter badly
        means, errors = rows.mean(axis=1), rows.std(axis=1, ddof=1) / np.sqrt(5)
        sides = [
            Estimates(n, ("K",), np.array([1e3 + m]), np.array([[e**2]]), np.array([4.0]))
            for n, m, e in zip("ab", means, errors, strict=True)
        ]
        alarms += compare.subset_tests(sides[0], sides[1], spread={"K": 0.0})[0].alarm
    assert 5 <= alarms <= 40, "stated: 1 %, 20 of 2000"


def flown(rng, heading_shift=0.0, responses=48):
    """Normal equations of throttle steps that all determine K alike, and the heading of each; K off by a share towards two of four
    headings."""
    headings = np.arange(responses) % 4 * (np.pi / 2)
    own = rng.normal(0.0, 0.01, responses) + np.where(headings < 2.0, heading_shift, -heading_shift)
    own -= own.mean()
    hessian = np.full((responses, 1, 1), 4.0)
    steps = [
        Segment(
            f"s{i}",
            "run",
            "throttle_step",
            {"throttle_0": 0.1, "throttle_1": 0.3},
            i,
            0.0,
            np.zeros(1),
            {},
            {},
            heading_rad=h,
        )
        for i, h in enumerate(headings)
    ]
    return Normal(("K",), hessian, hessian[:, :, 0] * (own * 50.0)[:, None]), steps


def test_the_discrepancy_is_measured_between_conditions():
    rng = np.random.default_rng(17)
    still = [measured(*flown(rng)[:1], ("K",), {"K": 50.0}, flown(rng)[1])["K"] for _ in range(20)]
    assert max(still) < prior("K"), "groups that agree pull it below the prior"
    for shift in (0.02, 0.05):
        normal, steps = flown(rng, shift)
        assert measured(normal, ("K",), {"K": 50.0}, steps)["K"] == pytest.approx(shift, rel=0.35)


def test_too_few_responses_keep_the_prior():
    normal, steps = flown(np.random.default_rng(18), 0.05, responses=5)
    assert measured(normal, ("K",), {"K": 50.0}, steps)["K"] == prior("K")


def test_what_the_responses_do_not_show_keeps_the_prior():
    """A fit of three windows of a simulated PX4 ended in a traceback: their innovations determined the roll loop, their responses did
    not."""
    normal, steps = flown(np.random.default_rng(18))
    made = measured(normal, ("K", "omega_phi"), {"K": 50.0, "omega_phi": 9.0}, steps)
    assert made == measured(normal, ("K",), {"K": 50.0}, steps)


def test_the_battery_of_a_campaign_is_estimated_from_all_its_flights():
    """One flight that hardly moves the current must not outweigh the one that does."""
    rng = np.random.default_rng(19)

    def recorded(name, current):
        t = np.arange(current.size) * 0.1
        volts = 24.0 - 0.02 * current + rng.normal(0.0, 0.05, current.size)
        return Recording(
            name, {"battery": Series(t, {"voltage_v": volts, "current_a": current})}, (), Provenance("", "table")
        )

    lively = recorded("thrust", 20.0 + 15.0 * np.sign(np.sin(np.arange(1200) * 0.2)))
    dull = recorded("yaw", 20.0 + rng.normal(0.0, 2.5, 300))
    value, std = battery_of([lively, dull])
    assert value == pytest.approx(0.02, abs=3.0 * std)
    assert std < 0.5 * battery_of([dull])[1]
    assert "UNTESTABLE" in battery_of([recorded("still", np.full(300, 20.0))])


def test_a_lag_alone_does_not_say_that_the_thrust_is_what_it_was():
    one = Estimates("a", ("sigma_t",), np.array([20.0]), np.array([[0.01]]))
    assert compare.subset_tests(one, one) == ()
    damping = Estimates("a", ("zeta_phi", "d_x"), np.array([0.4, 0.4]), np.eye(2) * 1e-6)
    assert [t.subset for t in compare.subset_tests(damping, damping)] == ["drag"]
    weak = Estimates("a", ("K", "sigma_t"), np.array([50.0, 20.0]), np.diag([400.0, 0.01]), weak=frozenset({"K"}))
    assert compare.subset_tests(weak, weak) == ()


def test_k_and_alpha_that_are_known_only_together_still_tell_the_thrust():
    there = -0.1
    values = np.array([50.0, 1.7])
    ridge = np.outer([-50.0 * there, 1.0], [-50.0 * there, 1.0]) * 3.0**2 + np.diag([(0.003 * 50.0) ** 2, 1e-6])
    both = [
        Estimates(n, ("K", "alpha"), values * [f, 1.0], ridge, None, there, frozenset({"K", "alpha"}))
        for n, f in (("a", 1.0), ("b", 0.94), ("c", 1.002))
    ]
    (test,) = compare.subset_tests(both[0], both[1])
    assert test.alarm
    assert list(test.shifts) == ["K"], "alpha by itself is not known"
    assert not compare.subset_tests(both[0], both[2])[0].alarm


def free_flight(rng, throttle, run, windows=9, volts=None):
    t = np.arange(0.0, 2.0, 0.02)
    made = []
    for i in range(windows):
        y = {"v_z_m_s": 0.02 * rng.normal() * t}
        if volts is not None:
            y["voltage_v"] = np.full(t.size, volts)
        edges = np.array([-1.0, 1.0]), np.array([0.9, 1.1]) * throttle * (1.0 + 0.003 * rng.normal())
        made.append(Segment(f"{run}{i}", run, "free", {}, i, 0.0, t, y, {"throttle": edges}))
    return made


def test_the_throttle_that_holds_height_shows_where_steps_were_not_flown():
    rng = np.random.default_rng(21)

    def level(throttle, volts=None):
        runs = [free_flight(rng, throttle * (1.0 + 0.004 * rng.normal()), f"run{k}", volts=volts) for k in range(3)]
        return hover([s for run in runs for s in run], 22.2)

    before = level(0.54)
    assert before.throttle == pytest.approx(0.54, rel=0.02)
    assert hover_test(before, level(0.54 * 1.08), None, 0.01).alarm
    test = hover_test(before, level(0.54 * 1.02), None, 0.01)
    assert not test.alarm, "packs differ by as much"
    assert test.subset == "thrust"
    # A battery at 0.93 of its voltage needs more throttle for the same thrust: explained first.
    full, low = level(0.2, 22.2), level(0.2 * 0.93**-1.7, 22.2 * 0.93)
    assert not hover_test(full, low, 1.7, 0.01).alarm
    assert hover_test(full, low, 0.0, 0.01).alarm, "a battery the autopilot compensates for explains nothing"
    assert hover(free_flight(rng, 0.5, "a", windows=2), 22.2) is None


def test_what_is_called_detectable_raises_the_alarm_and_half_of_it_does_not():
    std = np.diag((0.004 * np.array([20.0, 50.0])) ** 2)
    stored = Estimates("a", ("sigma_t", "K"), np.array([20.0, 50.0]), std)
    smallest = compare.subset_tests(stored, stored)[0].detectable["K"]
    for share, alarm in ((1.05, True), (0.5, False)):
        moved = Estimates("b", ("sigma_t", "K"), np.array([20.0, 50.0 * (1.0 - share * smallest)]), std)
        assert compare.subset_tests(stored, moved)[0].alarm is alarm


def test_a_slower_thrust_is_not_called_less_thrust():
    base = Estimates("m", ("sigma_t", "K"), np.array([20.0, 50.0]), np.diag([0.04, 0.04]))
    for values, lag in (([14.0, 50.1], True), ([20.0, 44.0], False)):
        new = Estimates("r", ("sigma_t", "K"), np.array(values), np.diag([0.04, 0.04]))
        found = assess(model_fingerprint={}, vehicle_fingerprint=None, stored=base, new=RecordingEvidence(runs=[new]))
        assert found.verdict is ValidityVerdict.STALE
        assert ("what delays the thrust" in found.sentence) is lag, found.sentence
        assert ("another mass (weigh it)" in found.could_also_be) is not lag


def test_what_the_model_did_not_determine_is_not_called_a_want_of_the_recording():
    """A recording that determines ten parameters "contains no information on attitude, yaw, drag": the model had K alone."""
    values, covariance = np.array([50.0, 25.0]), np.diag([0.04, 0.04])
    stored = Estimates("m", ("K",), values[:1], covariance[:1, :1])
    new = Estimates("r", ("K", "omega_phi"), values, covariance)
    said = assess(model_fingerprint={}, vehicle_fingerprint=None, stored=stored, new=RecordingEvidence(runs=[new]))
    assert "on attitude, yaw, drag it, or the model's own recordings, contain no information" in said.sentence


@pytest.mark.parametrize(("differs", "known"), [(0.005, True), (0.08, False)])
def test_a_mass_is_excluded_only_by_a_drag_that_would_show_it(differs, known):
    """Thrust per throttle had fallen by 7.5 %, "and not the mass", where drag was tested for changes of 20 % and more."""
    names = ("K", "d_x", "d_z")
    values, covariance = np.array([50.0, 0.4, 0.5]), np.diag((0.003 * np.array([50.0, 0.4, 0.5])) ** 2)
    stored, new = (
        Estimates("m", names, values, covariance),
        Estimates("r", names, values * [0.925, 1.0, 1.0], covariance),
    )
    spread = {"K": 0.005, "d_x": differs, "d_z": differs}
    seen = RecordingEvidence(runs=[new], spread=spread)
    said = assess(model_fingerprint={}, vehicle_fingerprint=None, stored=stored, new=seen).sentence
    assert ("and not the mass" in said) is known, said
    assert ("cannot distinguish them" in said) is not known


def test_what_like_steps_do_not_tell_the_estimates_are_asked_for():
    """Like steps determined d_z alone and best: that d_x had risen by 22 % went by."""
    names = ("d_x", "d_z")
    values, covariance = np.array([0.4, 0.55]), np.diag([1e-4, 1e-4])
    stored = Estimates("stored", names, values, covariance)
    new = Estimates("new", names, values * [1.22, 1.0], covariance)
    steps = MatchedPairs(stored.select(("d_z",)), stored.select(("d_z",)), 12)
    tests = subset_tests(stored, new, spread={"d_x": 0.03, "d_z": 0.03}, matched=steps)
    assert [tuple(t.shifts) for t in tests] == [("d_z",), ("d_x",)]
    assert [t.alarm for t in tests] == [False, True]
    assert sum(t.level for t in tests) == pytest.approx(FALSE_ALARM), "one level for the family of both"


def test_a_comparison_that_would_not_show_a_doubling_is_none():
    """Drag to a factor of fifteen was called 'as before'."""
    names, values = ("sigma_r", "d_y"), np.array([21.0, 0.02])
    known = Estimates("a", names, values, np.diag([0.04, 0.01]))
    tests = subset_tests(known, known, subsets={"yaw": ("sigma_r",), "drag": ("d_y",)})
    assert [t.subset for t in tests] == ["yaw"]
    assert tests[0].level == pytest.approx(FALSE_ALARM)
