"""MAVSDK, an independent client, against the built-in vehicle over both transports."""

import contextlib
import time
from collections.abc import Iterator

import pytest
from mavsdk import ComponentType, Configuration, Mavsdk
from mavsdk.plugins.action import Action
from mavsdk.plugins.param import Param
from mavsdk.plugins.telemetry import Telemetry

from flighttest.sim import SimOptions, start_simulator


def _until(condition, timeout_s: float = 8.0):
    end = time.monotonic() + timeout_s
    while time.monotonic() < end:
        value = condition()
        if value:
            return value
        time.sleep(0.02)
    raise AssertionError("nothing within the time given")


@pytest.fixture(params=["tcp", "udp"])
def system(request) -> Iterator[object]:
    """A MAVSDK system connected to a vehicle at 20 times real time, in GUIDED-ready state."""
    options = SimOptions(speed=20.0, ready_s=1.0, gps_s=2.0)
    with start_simulator(options, protocol=request.param, in_thread=True) as simulation:
        sdk = Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION))
        scheme = "tcpout" if request.param == "tcp" else "udpout"
        sdk.add_any_connection(f"{scheme}://127.0.0.1:{simulation.port}")
        try:
            yield sdk.first_autopilot(8.0)
        finally:
            with contextlib.suppress(AttributeError):
                sdk.destroy()


def test_mavsdk_reads_parameters_and_flies(system):
    assert system is not None
    parameters = Param(system)
    assert parameters.get_param_float("GUID_TIMEOUT") == pytest.approx(3.0)
    parameters.set_param_float("GUID_TIMEOUT", 1.5)
    assert parameters.get_param_float("GUID_TIMEOUT") == pytest.approx(1.5)
    telemetry, action = Telemetry(system), Action(system)
    telemetry.set_rate_attitude_euler(20.0)
    telemetry.set_rate_position(20.0)
    _until(lambda: telemetry.health().is_armable or telemetry.position().latitude_deg < -30.0)
    action.set_takeoff_altitude(4.0)
    _until(lambda: _try(action.arm))
    _until(lambda: _try(action.takeoff))
    _until(lambda: telemetry.position().relative_altitude_m > 3.0)
    assert abs(telemetry.attitude_euler().roll_deg) < 5.0
    assert telemetry.position().latitude_deg == pytest.approx(-35.3632621, abs=1e-4)
    action.land()
    _until(lambda: not telemetry.armed())


def _try(command) -> bool:
    try:
        command()
    except Exception:  # noqa: BLE001 - MAVSDK raises for every refusal, and a refusal is asked again
        return False
    return True
