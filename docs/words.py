"""The words of this project: one name per concept (`GLOSSARY`, written to docs/glossary.md), and the words that are gone (`GONE`).

Tests hold the code to both: every term of the glossary stands in the module that it names, and no word that is gone comes back.
"""

from __future__ import annotations

from typing import NamedTuple


class Entry(NamedTuple):
    """One concept. where: the module that is about it, in which the term stands; source: where the name is from."""

    term: str
    meaning: str
    where: str
    source: str = ""


TISCHLER = "Tischler & Remple, Aircraft and Rotorcraft System Identification, 2012"
LJUNG = "Ljung, System Identification, 1999"

GLOSSARY = (
    Entry(
        "attitude target",
        "roll, pitch, yaw rate and throttle asked of the autopilot at one moment",
        "script/model.py",
        "MAVLink SET_ATTITUDE_TARGET",
    ),
    Entry("batched rehearsal", "predicted flights of many steps integrated together", "plan/batched.py"),
    Entry(
        "best subsets",
        "the sets of candidate terms with the largest marginal likelihood",
        "diagnose/selection/subsets.py",
        "Miller, Subset Selection in Regression, 2002",
    ),
    Entry(
        "cell",
        "the setting that repeats of a step share (amplitude, throttles)",
        "segments/model.py",
        "design of experiments",
    ),
    Entry("channel", "one measured quantity: name, unit, frame", "channels.py"),
    Entry("clearance", "where in the zone a step can be flown, its stop and a lost link included", "plan/clearance.py"),
    Entry(
        "colored residuals",
        "residuals correlated in time, whose correlation is in the standard errors",
        "estimation/uncertainty/colored_residuals.py",
        "Morelli & Klein 1997",
    ),
    Entry("column map", "which column of a foreign table is which channel", "logs/tables/columns.py"),
    Entry(
        "CR2",
        "cluster-robust covariance with a small-sample correction",
        "estimation/uncertainty/covariance.py",
        "Bell & McCaffrey 2002",
    ),
    Entry(
        "cross-validated",
        "a model judged on groups of responses that were not used to fit it",
        "diagnose/selection/comparison.py",
        "Stone 1974",
    ),
    Entry(
        "CUSUM",
        "sum of standardised changes over runs, for slow drift",
        "validity/cusum.py",
        "Page 1954; self-starting: Hawkins 1987",
    ),
    Entry(
        "delay",
        "time from sending a reference to its first effect (dead time), one per channel",
        "physics/body.py",
        LJUNG,
    ),
    Entry(
        "external parameter change",
        "a vehicle parameter that somebody else set during a flight",
        "flight/preparation/changes.py",
    ),
    Entry("fingerprint", "components, firmware and parameters that a model is valid for", "vehicle/fingerprint.py"),
    Entry(
        "Fisher information",
        "what a planned flight would make known, before it is flown",
        "identify/expected_information.py",
        LJUNG,
    ),
    Entry("free flight", "recorded flight without separate steps, used in windows", "segments/cut.py"),
    Entry("gate", "decides for each target whether it may leave; drops, never clamps", "flight/gate.py"),
    Entry(
        "Gauss-Newton",
        "the iteration of every estimate, damped and within bounds",
        "estimation/gauss_newton.py",
        "Levenberg 1944, Marquardt 1963",
    ),
    Entry(
        "identifiable",
        "whether the data make a parameter known (identifiability)",
        "identify/diagnostics/identifiability.py",
        LJUNG,
    ),
    Entry(
        "integrated autocorrelation time",
        "samples that count as one in a correlated residual",
        "diagnose/residuals/discrepancy.py",
        "Sokal 1997",
    ),
    Entry(
        "lack of fit",
        "error that repeats of a cell have in common",
        "diagnose/residuals/discrepancy.py",
        "Draper & Smith, Applied Regression Analysis",
    ),
    Entry(
        "Laplace approximation",
        "a marginal likelihood by its second derivatives at the maximum",
        "diagnose/selection/subsets.py",
        "Tierney & Kadane 1986",
    ),
    Entry("leg", "one response to be flown: start, profile, phases", "plan/model.py"),
    Entry("linearisation", "whitened residuals and Jacobian at an optimum", "estimation/linearisation.py", TISCHLER),
    Entry("maneuver", "steps of one kind in a script", "script/model.py", TISCHLER),
    Entry(
        "marginal likelihood",
        "probability of the data under a model, parameters integrated out",
        "diagnose/selection/subsets.py",
        "MacKay 1992",
    ),
    Entry(
        "minimum detectable effect",
        "the smallest size of a term that the data would have shown",
        "diagnose/selection/detectability.py",
        "Bloom 1995",
    ),
    Entry(
        "model discrepancy",
        "what an equation gets wrong, as a random effect",
        "diagnose/residuals/discrepancy.py",
        "Kennedy & O'Hagan 2001",
    ),
    Entry(
        "noise floor",
        "error that no model can remove: the difference between repeats",
        "diagnose/residuals/lack_of_fit.py",
    ),
    Entry(
        "nuisance parameter",
        "initial state and disturbance of one response, eliminated before anything is compared",
        "estimation/linearisation.py",
        TISCHLER,
    ),
    Entry(
        "onset",
        "time between an applied input and the first observed change; the paper's estimate of the delay",
        "identify/dead_time.py",
        "paper, section 3",
    ),
    Entry("open loop", "a model driven by recorded inputs alone", "identify/validation/validate.py", TISCHLER),
    Entry("parameter", "a number of a term: symbol, unit, bounds, source", "physics/core.py"),
    Entry("port", "where a term acts in the chain from reference to measurement", "physics/core.py"),
    Entry("prior model", "the model that predicts a flight before it is flown", "pipeline/planning/predictor.py"),
    Entry("profile", "the course of targets within a step", "script/profiles/declare.py"),
    Entry(
        "recording", "channels of one flight on the vehicle's clock, with marks and provenance", "recording/model.py"
    ),
    Entry("reference", "what was commanded, held until the next sample", "channels.py", LJUNG),
    Entry("response", "what the vehicle did after a step: the unit that is fitted", "segments/model.py"),
    Entry(
        "Satterthwaite",
        "degrees of freedom of a variance estimated from few clusters",
        "estimation/uncertainty/covariance.py",
        "Satterthwaite 1946",
    ),
    Entry(
        "Schur complement",
        "how nuisance parameters are eliminated from normal equations",
        "estimation/linearisation.py",
    ),
    Entry(
        "sparse regression",
        "residual regression: the shape of what no catalogue entry fits, as few functions of the state",
        "diagnose/output_error/residual_regression.py",
        "Brunton, Proctor, Kutz 2016",
    ),
    Entry("specific force", "what an accelerometer measures: acceleration without gravity", "channels.py"),
    Entry("supervisor", "what happens when a target was refused", "flight/execution/supervisor.py"),
    Entry("term", "one piece of physics that can be added to a model", "physics/core.py"),
    Entry("tied", "parameters that share one value (equality constraint)", "identify/equality_constraints.py"),
    Entry("zone", "the box that a flight must stay in", "vehicle/model.py"),
)

# Words of the textbooks that a reader searches for, and the module that is about each, in which it stands as written here.
SEARCHED = (
    ("autocorrelation", "identify/diagnostics/residuals.py"),
    ("Bode", "identify/response_analysis/frequency_response.py"),
    ("bootstrap", "diagnose/selection/held_out.py"),
    ("Box-Jenkins", "identify/free_flight/loops.py"),
    ("closed-loop bias", "estimation/uncertainty/closed_loop.py"),
    ("coherence", "identify/response_analysis/frequency_response.py"),
    ("covariance", "estimation/uncertainty/covariance.py"),
    ("Cramer-Rao", "identify/expected_information.py"),
    ("Cramér-Rao", "identify/expected_information.py"),
    ("cross-validated", "diagnose/selection/comparison.py"),
    ("dead time", "identify/dead_time.py"),
    ("doublet", "script/profiles/attitude.py"),
    ("equality constraint", "identify/equality_constraints.py"),
    ("equation error", "estimation/equation_error/__init__.py"),
    ("Fisher information", "identify/expected_information.py"),
    ("frequency response", "identify/response_analysis/frequency_response.py"),
    ("Gauss-Newton", "estimation/gauss_newton.py"),
    ("identifiable", "identify/diagnostics/identifiability.py"),
    ("information matrix", "identify/expected_information.py"),
    ("Jacobian", "estimation/linearisation.py"),
    ("lack of fit", "diagnose/residuals/discrepancy.py"),
    ("local optima", "identify/diagnostics/local_optima.py"),
    ("maximum likelihood", "identify/fit.py"),
    ("multistart", "identify/diagnostics/local_optima.py"),
    ("nuisance parameter", "estimation/linearisation.py"),
    ("output error", "identify/fit.py"),
    ("overshoot", "segments/metrics.py"),
    ("power spectral density", "segments/health.py"),
    ("residual analysis", "identify/diagnostics/residuals.py"),
    ("rise time", "segments/metrics.py"),
    ("Runge-Kutta", "physics/simulate.py"),
    ("score test", "diagnose/selection/candidates.py"),
    ("sensitivities", "diagnose/selection/candidates.py"),
    ("specific force", "channels.py"),
    ("standard error", "estimation/uncertainty/covariance.py"),
    ("whiteness", "identify/diagnostics/residuals.py"),
    ("zero-order hold", "physics/simulate.py"),
)

# What a reader asks, the word to search `flighttest/` for, and the module that answers: among the four files that hold the word most often.
QUESTIONS = (
    ("Where do standard errors come from?", "cluster", "estimation/uncertainty/covariance.py"),
    ("Where is the score test?", "score test", "diagnose/selection/candidates.py"),
    ("How is a term judged on data that it was not fitted to?", "cross-validated", "diagnose/selection/comparison.py"),
    ("How does a term get into the report?", "finding", "report/sections/diagnosis.py"),
    ("How is a change of mode confirmed?", "confirm", "link/ardupilot.py"),
    ("What happens when a target is refused?", "abort mode", "flight/execution/supervisor.py"),
    ("How are parameters put back after a flight?", "restored", "flight/preparation/changes.py"),
    ("Who says that a model is stale?", "stale", "validity/assess.py"),
    ("How is the model integrated?", "Runge-Kutta", "physics/simulate.py"),
    ("Why was a response rejected?", "take-over", "segments/quality.py"),
    # Asked later by a reader who had the listing and the search alone. Two had no answer then: "clock offset" and "voltage sag".
    ("How far is the vehicle's clock from the ground's?", "clock offset", "mavlink/clock.py"),
    ("Which responses are set aside as outlying?", "outlying", "diagnose/residuals/outlying.py"),
    ("Where does a command get its exit code?", "exit code", "cli/main.py"),
    ("Who writes raw.tlog?", "raw.tlog", "flight/recorder.py"),
    ("Where is the dead time of a response read off?", "dead time", "identify/dead_time.py"),
    ("How is a pilot's take-over detected?", "take-over", "flight/execution/control.py"),
    ("How small an effect would have been detected?", "minimum detectable", "diagnose/selection/detectability.py"),
    ("How is an interrupted run resumed?", "resume", "pipeline/store/resuming.py"),
    ("Where is the physics of voltage sag?", "voltage sag", "physics/terms/propulsion.py"),
    ("Which components and parameters is a model valid for?", "fingerprint", "vehicle/fingerprint.py"),
    # Ten more of another reader. Five had no answer then: "geofence", "sensor noise", "throttle curve", "confidence interval", "position
    # loop".
    ("How is a geofence brought onto the vehicle?", "geofence", "link/onboard/fence.py"),
    ("Where is the sensor noise of the built-in vehicle?", "sensor noise", "sim/sensors.py"),
    ("Where is the throttle curve?", "throttle curve", "physics/terms/propulsion.py"),
    ("How is the next flight chosen?", "next flight", "diagnose/next_flight.py"),
    ("How is the vehicle brought back between steps?", "position loop", "flight/execution/reset.py"),
    ("Where is a confidence interval made?", "confidence interval", "identify/fit.py"),
    ("Which model of a vehicle is in use?", "model in use", "pipeline/store/lineage.py"),
    ("Which target may always be sent?", "release target", "flight/gate.py"),
    ("How does a model become C?", "C99", "identify/models/export.py"),
    ("How are gaps of a recording found?", "gap", "segments/health.py"),
)

# What is gone: pattern and what to say. Matched as a whole word, in any case, also as a part of names like flight_house_m.
GONE = {
    "house": "architecture, conventions",
    "rooms": "packages",
    "waist": "interface",
    "hourglass": "interface",
    "cockpit": "flight code; FlightControl",
    "helm": "FlightControl.steer",
    "meddl(?:ing|ed|es?)": "external parameter change",
    "strangers?": "what it is",
    "stands? in for": "is taken for, is used in place of",
    "nobody can explain": "noise floor",
    "mothers?": "original, planned row",
    "look_ahead": "two-step forward selection",
    "another_way": "restart",
    "remainders": "backward elimination; what is left",
    "strays?": "outlying clusters",
    "chance[.]plain": "few-cluster rule",
    "does_not_stand_out": "not significant (Wald)",
    "constancy": "heterogeneity test",
    "carried_over": "informative prior",
    "alternation": "block coordinate descent",
    "currency": "validity of a model",
    "zone_room\\w*": "clearance",
    "keeping": "model store, kept",
    "dormant": "inactive",
    "carriers": "effective clusters",
    "secants?": "finite difference",
    "valley": "quadratic model",
    "in_halves": "in_parallel",
    "whole truth": "all of it",
    "tells": "shows, determines, distinguishes",
    "wants": "needs, asks for",
    "untold": "unreported, not determined",
    "told(?!_apart| apart by)": "determined, distinguished, reported",  # told_apart_by: a field of terms, which users write
    "doubts_of": "identifiability diagnostics of a parameter",
    "feeding": "data selection",
    "like_with_like": "matched pairs",
    "nobody": "not, no sender, no receiver",
    "whoever": "the sender, the recorder, the pilot: who it is",
    "knows": "depends on, has, determines",
    "believe[sd]?": "takes for, uses",
    "thinks?": "estimates, takes",
    "speaks?": "sends",
    "vouch(?:es|ed|ing)?": "confirms",
    "honest(?:ly)?": "calibrated, as measured",
    "swallow(?:s|ed)?": "hides",
    "lets? go|letting go": "release target; stops sending",
    "by the way": "in passing, constant",
}

# Names that are gone from the code as names of modules, classes, functions and constants; as words of a sentence some are ordinary English.
# Pattern of the whole name, and what to say.
GONE_NAMES = {
    "Bench|bench": "Estimator",
    "Rows": "Linearisation, or what the rows are of",
    "Ground|Variant": "base projection, candidate at a fixed shape",
    "WANDER": "estimator drift",
    "pairs|another_way|swap": "two-step forward selection, restart, exchange step",
    "plausible|does_not_stand_out": "admissible, not significant",
    "Rival|rivals": "LocalOptimum; in a diagnosis a rival is an aliased candidate, as diagnosis.json has it",
    "Spread|spreads|constancy": "Heterogeneity",
    "Doubts|doubts": "ParameterDiagnostics, inconsistencies",
    "weighing|Weighing|_?Valley": "likelihood weights, quadratic model",
    "Held": "AtFixedParameters",
    "variations": "ablations",
    "student|sag|Told": "distributions, voltage interpolation, planned information",
    "Currency|Alike|alike|matters|sequence": "Assessment, matched pairs, impact, CUSUM",
    "halves|about|views": "parallel, info, presenters",
    "present|Present|once": "live vehicle, deduplicate",
    "together|_?Mother|Ask": "batched rehearsal",
    "room|meddling": "clearance, external parameter change",
}

# Names that stay, with the reason.
KEPT_NAMES = {
    "flighttest/diagnose/model.py: Rival": "a key of diagnosis.json",
    "flighttest/estimation/linearisation.py: once": "a value computed once",
    "flighttest/segments/model.py: once": "a value computed once",
}

# Where such a word is still found, and how often: a number may only fall, and an entry without its word must go.
STILL: dict[str, dict[str, int]] = {
    "currency": {"flighttest/pipeline/flights/after_landing.py": 1},  # a key of what --json prints
    # A key of model files.
    "alternation": {
        "flighttest/identify/diagnostics/parameter_diagnostics.py": 1,
        "flighttest/identify/validation/block_coordinate_descent.py": 1,
    },
}
