import numpy as np
import pytest

from flighttest.plan.outer_loop import Moving, OuterLoop, along


@pytest.mark.parametrize("yaw", [0.0, 1.0, -2.5])
@pytest.mark.parametrize("goal", [(3.0, 0.0, 0.0), (-2.0, 4.0, 1.0), (0.0, -3.0, -1.0)])
def test_it_brings_the_vehicle_there_and_stops_it(predictor, yaw, goal):
    loop = OuterLoop()
    hover = predictor.hover_throttle(np.array([23.0]))

    def policy(now):
        return loop.steer(Moving(now.p_m, now.v_m_s, now.rpy_rad[:, 2]), Moving(goal, (0.0, 0.0, 0.0), 0.5), hover)

    flown = predictor.fly(np.zeros((1, 3)), np.array([yaw]), np.array([23.0]), policy, 14.0, 0.02)
    assert flown.p_m[0, -1] == pytest.approx(goal, abs=0.1)
    assert np.linalg.norm(flown.v_m_s[0, -1]) < 0.1
    assert flown.rpy_rad[0, -1, 2] == pytest.approx(0.5, abs=0.05)
    overshoot = np.max(flown.p_m[0] @ np.array(goal) / np.dot(goal, goal))
    assert overshoot < 1.25


def test_targets_stay_bounded_however_far_the_goal():
    row = OuterLoop().steer(Moving((0, 0, 0), (0, 0, 0), 0.0), Moving((1e4, -1e4, 1e4), (0, 0, 0), 3.0), 0.2)[0]
    assert abs(row[0]) <= 0.35
    assert abs(row[1]) <= 0.35
    assert row[0] > 0 < row[1]  # goal ahead (nose down) and to the right (left side up)
    assert 0.0 < row[3] < 0.4


def test_a_timed_path():
    path = ((0.0, 0.0, 0.0, 5.0), (2.0, 4.0, 0.0, 5.0), (3.0, 4.0, 0.0, 6.0))
    place, pace = along(path, 1.0)
    assert place == pytest.approx([2.0, 0.0, 5.0])
    assert pace == pytest.approx([2.0, 0.0, 0.0])
    assert along(path, 9.0)[0] == pytest.approx([4.0, 0.0, 6.0])
    assert along(path, 9.0)[1] == pytest.approx([0.0, 0.0, 0.0])
