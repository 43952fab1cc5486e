"""Fits on the bench where most candidates are refitted: what they do where nothing can be fitted."""

import warnings
from dataclasses import replace

import numpy as np
from flight import campaign, fly
from flighttest.diagnose.bench import Bench

from flighttest.identify.fit import default_model


def test_from_where_the_simulation_is_not_finite_nothing_is_tried():
    segments = tuple(fly(campaign(1, yaws=False)))
    bench, model = Bench(segments, "translation"), default_model(segments)
    far = bench.start(model, {"K": 1e200})
    assert not np.isfinite(far.objective)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert bench.fit(model, far, ("K", "sigma_t")) is far
    near = bench.fit(model, bench.start(model, {"K": 40.0}), ("K", "sigma_t"))
    assert np.isfinite(near.objective)
    assert near.values["K"] > 45.0


def test_a_bench_tells_models_apart_by_all_that_they_are():
    segments = tuple(fly(campaign(1, yaws=False)))
    bench, model = Bench(segments, "translation"), default_model(segments)
    assert bench.problem(model) is bench.problem(replace(model))
    others = [
        replace(model, nominal_voltage_v=11.1),
        replace(model, rotor_height_m=0.5),
        model.with_terms("ground_effect"),
    ]
    assert len({id(bench.problem(m)) for m in (model, *others)}) == 4
