"""The vehicle's clock from delayed, jittering, drifting messages."""

import numpy as np
import pytest

from flighttest.errors import RecordingError
from flighttest.mavlink import estimate_clock


def stamps(
    span_s: float = 300.0, drift: float = 0.0, delay_s: float = 0.02, seed: int = 1
) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    vehicle = np.arange(0.0, span_s, 0.02)
    ground = 1.7e9 + vehicle * (1.0 + drift) + delay_s + rng.exponential(0.004, vehicle.size)
    return ground, vehicle


def trips(span_s: float, drift: float = 0.0, up_s: float = 0.012, down_s: float = 0.02) -> np.ndarray:
    t = np.arange(1.0, span_s, 1.0)
    late = np.where(
        np.arange(t.size) % 7 == 0, 0.0, 0.08
    )  # most round trips are slow one way, which a mean would take over
    sent = 1.7e9 + t * (1.0 + drift)
    return np.column_stack([sent, t + up_s, sent + up_s + down_s + late])


@pytest.mark.parametrize("drift", [0.0, 3e-5, -1e-4])
def test_timesync_finds_the_offset_within_half_the_shortest_round_trip(drift: float) -> None:
    ground, vehicle = stamps(drift=drift)
    clock = estimate_clock(ground, vehicle, trips(300.0, drift))
    wanted = np.array([20.0, 150.0, 280.0])
    found = clock.to_vehicle(1.7e9 + wanted * (1.0 + drift))
    assert np.max(np.abs(found - wanted)) < 0.5 * 0.032
    assert np.ptp(found - wanted) < 0.003, "the drift must be followed"
    assert clock.error_s <= 0.05


def test_without_timesync_the_shortest_delay_stays_unknown_and_the_error_says_so() -> None:
    ground, vehicle = stamps()
    clock = estimate_clock(ground, vehicle)
    found = float(clock.to_vehicle(1.7e9 + 100.0))
    assert found == pytest.approx(100.0 - 0.02, abs=0.002)
    assert clock.error_s >= 0.02


def test_a_congested_link_does_not_bend_the_clock() -> None:
    ground, vehicle = stamps()
    late = np.where((vehicle > 100.0) & (vehicle < 140.0), 0.5, 0.0)
    clock = estimate_clock(ground + late, vehicle)
    assert float(clock.to_vehicle(1.7e9 + 120.0)) == pytest.approx(120.0 - 0.02, abs=0.02)


def test_a_simulator_at_its_own_pace() -> None:
    vehicle = np.arange(0.0, 200.0, 0.02)
    ground = 1.7e9 + vehicle / 10.0
    clock = estimate_clock(ground, vehicle)
    assert float(clock.to_vehicle(1.7e9 + 10.0)) == pytest.approx(100.0, abs=0.2)
    assert clock.rate == pytest.approx(10.0, rel=0.01)


def test_nothing_known() -> None:
    with pytest.raises(RecordingError):
        estimate_clock([], [])
