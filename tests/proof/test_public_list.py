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
        ("copter_3.2_2014.BIN", 0.09, 0.035),
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


def test_a_motor_is_at_its_limit_in_the_flights_that_have_one_and_in_no_others(repository, shared_data):
    """Of the logs with motor commands; 0.02 of the flight is a start and a few jerks."""
    for one in read_sets(repository / "examples" / "recordings" / "public.yaml"):
        if "motor_data" not in one.name:
            continue
        for flown in open_recordings(sorted(shared_data.glob(one.files[0])), Reading(None)):
            spans = flights(flown)
            shares = []
            for t, command in (flown.channel(f"motor_{k}") for k in range(1, 5)):
                flying = np.any([(t >= a) & (t <= b) for a, b in spans], axis=0)
                shares.append(float(np.mean(command[flying] > 0.999)))
            assert (max(shares) > 0.03) is ("motor_saturation" in one.own), (one.name, flown.name, shares)


@pytest.mark.slow
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


def trims(recording, first, last):
    """What front and rear motors differ by per m/s ahead, left and right ones per m/s to the left, of full throttle, and R^2 of each: over
    a second, beside the velocity, the rate and its derivative. Motors 1 to 4 of ArduPilot's X: front right, rear left, front left, rear
    right."""
    t, second = np.arange(first, last, 0.1), np.ones(10) / 10.0

    def along(name):
        times, values = recording.channel(name)
        return np.interp(t, times, np.unwrap(values) if name == "yaw_rad" else values)

    m1, m2, m3, m4 = (along(f"motor_{k}") for k in (1, 2, 3, 4))
    north, west, up, yaw = (along(name) for name in ("v_x_m_s", "v_y_m_s", "v_z_m_s", "yaw_rad"))
    velocity = [np.cos(yaw) * north + np.sin(yaw) * west, np.cos(yaw) * west - np.sin(yaw) * north, up]
    found = []
    for k, (trim, rate) in enumerate(((m1 + m3 - m2 - m4, along("q_rad_s")), (m2 + m3 - m1 - m4, along("p_rad_s")))):
        columns = [*velocity, rate, np.gradient(rate, 0.1)]
        y, *x = (np.convolve(v - v.mean(), second, "valid") for v in (0.5 * trim, *columns))
        slopes = np.linalg.lstsq(np.stack(x, axis=1), y, rcond=None)[0]
        found.append((float(slopes[k]), 1.0 - float(np.var(y - np.stack(x, axis=1) @ slopes) / np.var(y))))
    return found


def test_motors_of_a_real_vehicle_make_up_for_moments_by_its_speed_and_those_of_a_simulated_one_do_not(shared_data):
    """Before its failure, at 350 s; of the first half the pitch axis shows nothing (R^2 0.16)."""
    real, simulated = (
        open_recording(shared_data / "arducopter_logs" / log)
        for log in ("copter_3.4_mechanical_failure.bin", "sitl_4.7dev_steps.BIN")
    )
    (_, (early, _)), ((ahead, explained), (left, most)) = trims(real, 244.0, 297.0), trims(real, 297.0, 348.0)
    assert -0.017 < early < -0.009
    assert -0.017 < left < -0.009
    assert -0.025 < ahead < -0.015
    assert min(explained, most) > 0.6
    first, last = max(flights(simulated), key=lambda span: span[1] - span[0])
    assert all(abs(slope) < 0.001 for slope, _ in trims(simulated, first + 2.0, last - 2.0))
