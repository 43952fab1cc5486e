"""What the list of public recordings supports by the recordings themselves is seen in them without this program's estimators."""

import json

import numpy as np
import pandas as pd
import pytest

from flighttest.pipeline.recordings.sources import Reading, open_recording, open_recordings
from flighttest.proof.recorded.sets import read_sets
from flighttest.segments.airborne import flights


def arms(recording, first, last):
    """(arm_z by f_x over dq/dt, by f_y over -dp/dt), m: least squares beside the rates, of what lies between 1 and 4 Hz."""
    t, _ = recording.channel("p_rad_s")
    even = np.arange(first, last, float(np.median(np.diff(t))))
    frequency = np.fft.rfftfreq(even.size, even[1] - even[0])
    inside = (frequency > 1.0) & (frequency < 4.0)

    def spectrum(name, times=0):
        value = np.interp(even, *recording.channel(name))
        for _ in range(times):
            value = np.gradient(value, even[1] - even[0])
        return np.fft.rfft(value * np.hanning(even.size))[inside]

    found = []
    for force, rate, sign in (("f_x_m_s2", "q_rad_s", 1.0), ("f_y_m_s2", "p_rad_s", -1.0)):
        columns = np.stack([sign * spectrum(rate, 1), spectrum(rate)], axis=1)
        gram = (columns.conj().T @ columns).real
        found.append(float(np.linalg.solve(gram, (columns.conj().T @ spectrum(force)).real)[0]))
    return found


@pytest.mark.parametrize(
    ("log", "arm_m", "within"),
    [
        ("copter_3.4_erlebrain3.BIN", 0.05, 0.005),
        ("copter_3.4_mechanical_failure.bin", 0.05, 0.008),
        ("sitl_4.7dev_steps.BIN", 0.0, 0.003),
    ],
)
def test_an_imu_off_the_centre_of_mass_is_seen_alike_by_two_axes_in_two_parts_of_the_log(
    shared_data, log, arm_m, within
):
    """Nothing relates f_x over dq/dt to f_y over -dp/dt but the arm; a simulated vehicle, whose IMU is in its centre of mass, has none."""
    recording = open_recording(shared_data / "arducopter_logs" / log)
    first, last = max(flights(recording), key=lambda span: span[1] - span[0])
    half = 0.5 * (first + last)
    found = [*arms(recording, first + 2.0, half), *arms(recording, half, last - 2.0)]
    np.testing.assert_allclose(found, arm_m, atol=within)


def test_the_fans_blow_along_the_axis_and_towards_the_side_that_is_declared(repository, shared_data):
    """A vehicle that keeps its place on the average leans its thrust against the air: without any estimator."""
    listed = read_sets(repository / "examples" / "recordings" / "public.yaml")
    lean = {}
    for one in (s for s in listed if s.wind_m_s is not None):
        leans = []
        for file in one.found(shared_data):
            (flown,) = open_recordings([file], Reading(one.columns))
            roll, pitch, yaw = (flown.channel(f"{a}_rad")[1] for a in ("roll", "pitch", "yaw"))
            x = np.cos(yaw) * np.sin(pitch) * np.cos(roll) + np.sin(yaw) * np.sin(roll)
            y = np.sin(yaw) * np.sin(pitch) * np.cos(roll) - np.cos(yaw) * np.sin(roll)
            leans.append((np.nanmean(x), np.nanmean(y)))
        lean[one.wind_m_s] = np.mean(leans, axis=0)
    still = lean.pop((0.0, 0.0))
    assert set(lean) == {(-4.2, 0.0), (-8.5, 0.0)}
    for wind, leans in lean.items():
        north, west = leans - still
        assert north * wind[0] < 0.0
        assert abs(west) < 0.1 * abs(north)
    assert lean[-8.5, 0.0][0] - still[0] > 1.5 * (lean[-4.2, 0.0][0] - still[0])


def test_motors_make_up_for_moments_by_forward_speed_with_and_without_wind(shared_data):
    """What front and rear motors differ by, over a second, beside the velocity: 20 to 23 us per m/s ahead in still air, where a third to
    three quarters of it is explained, 24 to 26 in 4.2 m/s; per m/s of climb none, and 47 to 55 less."""
    ahead, climb = {}, {}
    for path in sorted((shared_data / "wind_tunnel").glob("*_*wind.csv.gz")):
        air = path.name.split("_")[-1].removesuffix(".csv.gz")
        table = pd.read_csv(path)
        v, motors = (np.array([json.loads(row) for row in table[name]]) for name in ("v", "pwm"))
        second = np.ones(50) / 50.0
        trim, *velocity = (
            np.convolve(x - x.mean(), second, "valid") for x in (0.5 * motors @ [-1.0, 1.0, -1.0, 1.0], *v.T)
        )
        found = np.linalg.lstsq(np.stack(velocity, axis=1), trim, rcond=None)[0]
        ahead.setdefault(air, []).append(found[0])
        climb.setdefault(air, []).append(found[2])
    assert np.all(np.abs(np.array(ahead["nowind"]) - 21.0) < 3.0)
    assert np.all(np.abs(np.array(ahead["35wind"]) - 25.0) < 3.0)
    assert np.all(np.abs(climb["nowind"]) < 3.0)
    assert np.all(np.array(climb["35wind"]) < -40.0)
