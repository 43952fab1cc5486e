"""Ctrl-C before anything was changed on the vehicle: the program ends at once."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from flighttest.flight import FlightOutcome, FlightState
from flighttest.link.session import CONNECT_S
from flighttest.sim import SimOptions
from tests.faults.proxy import EPOCH_S, Fault, Proxy, When
from tests.flight.faulty import FaultyLink, fly, make_leg, make_plan, options

PRESSED_S = 0.3  # into the stage
QUICK_S = 0.5


def press(proxy: Proxy, stage: str) -> tuple[Callable[[str], None], Callable[[], int], list[float]]:
    """Stages as they begin, how often the key was pressed, and when that stage began."""
    began: list[float] = []

    def begins(text: str) -> None:
        if text == stage:
            began.append(proxy.now_s)

    return begins, lambda: int(bool(began) and proxy.now_s > began[0] + PRESSED_S), began


@pytest.mark.parametrize("stage", ["connecting", "reading parameters", "asking for telemetry"])
def test_ctrl_c_before_anything_is_changed_ends_at_once(stage: str, run_dir: Path) -> None:
    silent = Fault("silent", 1e6, down=True, up=True) if stage == "connecting" else Fault("nothing")
    options = SimOptions(lockstep=False, ready_s=1.0, gps_s=2.0)
    proxy = Proxy(options, silent, When.CONNECTING)
    if stage == "connecting":
        proxy.began_s = EPOCH_S
    begins, pressed, began = press(proxy, stage)
    result = fly(
        make_plan(),
        "proxy",
        run_dir,
        transport=proxy,
        clock=proxy.clock(),
        stop_requested=pressed,
        on_stage=begins,
    )
    assert result.outcome is FlightOutcome.OPERATOR_STOP
    assert result.left is FlightState.NOT_ARMED
    assert not result.parameters_left
    assert proxy.now_s - began[0] < PRESSED_S + QUICK_S < CONNECT_S
    assert not proxy.reached(When.PREFLIGHT), "nothing was set"


@pytest.mark.parametrize("by", ["the operator", "the pilot"])
def test_a_rest_with_motors_off_ends_at_once(by: str, run_dir: Path) -> None:
    """Ctrl-C was answered after the rest, up to five minutes later; a pilot who armed was noticed then, and not at all once disarmed."""
    link = FaultyLink(options())
    plan = make_plan(replace(make_leg("rest", duration_s=60.0), motors_off=True), make_leg())
    began: list[float] = []

    def hook(message: object, t_s: float) -> None:
        if message.get_type() == "STATUSTEXT" and not began:  # type: ignore[attr-defined]
            began.append(t_s)
            link.sim.vehicle.armed = by == "the pilot"

    link.hook = hook
    stop = lambda: int(bool(began) and by == "the operator")  # noqa: E731
    result = fly(plan, "sim", run_dir, transport=link, stop_requested=stop)
    assert result.outcome is (FlightOutcome.OPERATOR_STOP if by == "the operator" else FlightOutcome.ARMED_BY_PILOT)
    marks = [t for t, kind in link.sent if kind == "STATUSTEXT"]
    assert marks[-1] - began[0] < 1.5
    assert "SET_ATTITUDE_TARGET" not in {kind for _, kind in link.sent}
