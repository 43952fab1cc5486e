"""What a user of the library may write, with every answer's type said: checked by `mypy --strict` against the wheel, never run."""

from pathlib import Path
from typing import assert_type

import flighttest as ft

flight = ft.read("flight.BIN")
assert_type(flight, ft.Recording)
responses = ft.segment(flight)
assert_type(responses, ft.Responses)
print(responses, len(responses.usable), responses.to_frame().shape)

fitted = ft.fit(flight, model=ft.Model() + "ground_effect", freeze={"alpha": 2.0}, progress=print)
for name, estimate in fitted.parameters.items():
    interval: tuple[float, float] | None = estimate.interval_95
    print(name, estimate.value, estimate.std, interval)
assert_type(fitted.model, ft.FittedModel)
print(fitted.model.equations(), fitted.model.citations(), fitted.model.write("model.yaml"))
print((ft.Model() + ft.terms.ground_effect).names)

found = ft.diagnose(flight, model=fitted.model, weather="still")
assert_type(found.accepted, tuple[str, ...])
print(found.verdict.value, [where.sentence for where in found.located])
assert_type(found.write_page("page.html"), Path)
found.plot().show()
print(ft.validate(fitted.model, "run").to_frame(), ft.check_validity(flight, model=fitted.model).fly)

assert_type(ft.plan("thrust").ok, bool)
flown = ft.fly("thrust", hide=["ground_effect:R2_m2=0.1"])
assert_type(flown.recordings(), tuple[ft.Recording, ...])
with ft.simulate("rotor", hide={"ground_effect": {"R2_m2": 0.1}}) as vehicle:
    assert_type(vehicle.url, str)
simulated = fitted.model.simulate({"t_s": [0.0, 1.0], "throttle": [0.2, 0.3]})
assert_type(simulated, ft.Simulated)

try:
    ft.models("runs").in_use("hexa-1")
except ft.FlighttestError as error:
    assert_type(error.hint, str)
