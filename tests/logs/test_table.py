import io

import numpy as np
import pandas as pd
import pytest

from flighttest import frames
from flighttest.errors import RecordingError
from flighttest.logs import import_log
from flighttest.logs.tables.columns import parse_columns
from tests.logs.tables import N, mapped, save


@pytest.fixture
def t():
    return np.arange(N) * 0.02


def test_a_plain_table_is_read_by_its_names(tmp_path, t):
    path = save(
        tmp_path / "a.csv", t_s=t, roll_rad=0.1 + 0 * t, pitch_rad=0 * t, yaw_rad=0 * t, throttle=0.3, voltage_v=22.0
    )
    r = import_log(path)
    assert r.provenance.importer == "table"
    assert r.channel("roll_rad")[1][0] == 0.1
    assert r.channel("throttle")[1][-1] == 0.3
    np.testing.assert_allclose(r.channel("voltage_v")[0], t)
    assert r.provenance.losses == ()


@pytest.mark.parametrize("name", ["a.parquet", "a.csv.gz", "a.tsv"])
def test_other_containers(tmp_path, t, name):
    frame = pd.DataFrame({"t_s": t, "roll_rad": 0.1, "v_x_m_s": t})
    path = tmp_path / name
    if name == "a.parquet":
        frame.to_parquet(path)
    else:
        frame.to_csv(path, index=False, sep="\t" if name == "a.tsv" else ",")
    r = import_log(path)
    np.testing.assert_allclose(r.channel("v_x_m_s")[1], t)
    assert "central differences" in r.provenance.derived["a_x_m_s2"]


def test_a_voltage_that_no_battery_has_is_missing(tmp_path, t):
    volts = np.where(np.arange(N) % 50 == 0, 0.0, 22.0)
    r = import_log(save(tmp_path / "a.csv", t_s=t, roll_rad=0 * t, voltage_v=volts))
    assert np.nanmin(r.channel("voltage_v")[1]) == 22.0
    assert any("4 values of 1 V or less are taken as missing" in loss for loss in r.provenance.losses)
    dead = import_log(save(tmp_path / "b.csv", t_s=t, roll_rad=0 * t, voltage_v=-1.0))
    assert not dead.has("voltage_v")


def test_a_change_of_mode_is_marked(tmp_path, t):
    r = import_log(save(tmp_path / "a.csv", t_s=t, mode=np.where(t < 2.0, 20, 4), roll_rad=0 * t))
    assert [(m.t_s, m.data["mode"]) for m in r.markers if m.kind == "mode"] == [(0.0, 20), (2.0, 4)]


def test_rows_without_a_mode_change_none(tmp_path, t):
    mode = np.where(np.arange(N) % 3 == 0, 20.0, np.nan)
    r = import_log(save(tmp_path / "a.csv", t_s=t, mode=mode, armed=1, roll_rad=0 * t))
    assert [m.data["mode"] for m in r.markers if m.kind == "mode"] == [20]
    assert not import_log(save(tmp_path / "b.csv", t_s=t, mode=np.nan * t, roll_rad=0 * t)).markers


def test_a_throttle_below_zero_is_refused(tmp_path, t):
    with pytest.raises(RecordingError, match="from -1 to"):
        import_log(save(tmp_path / "a.csv", t_s=t, roll_rad=0 * t, throttle=np.where(t < 1.0, -1.0, 0.3)))


def test_a_misspelt_column_is_reported(tmp_path, t):
    path = save(tmp_path / "a.csv", t_s=t, roll_rad=0 * t, picth_rad=0 * t)
    losses = import_log(path).provenance.losses
    assert losses == ("column 'picth_rad' is not a channel and was not read; did you mean pitch_rad?",)


def test_ned_and_frd_become_nwu_and_flu(tmp_path, t):
    one = 0 * t + 1.0
    r = mapped(
        tmp_path,
        "frame: {world: NED, body: FRD}\ncolumns:\n  t_s: {from: us, unit: us}\n  roll_rad: {from: r, unit: deg}\n"
        "  pitch_rad: {from: p, unit: deg}\n  yaw_rad: {from: y, unit: deg}\n  q_rad_s: q\n  f_z_m_s2: {from: fz, unit: g}\n"
        "  v_y_m_s: vy\n  v_z_m_s: vz\n  height_m: h\n  yaw_rate_ref_rad_s: rr\n",
        us=t * 1e6, r=10 * one, p=20 * one, y=30 * one, q=one, fz=-one, vy=2 * one, vz=3 * one, h=4 * one, rr=one,
    )  # fmt: skip
    value = {
        n: r.channel(n)[1][5]
        for n in ("roll_rad", "pitch_rad", "yaw_rad", "q_rad_s", "f_z_m_s2", "v_y_m_s", "v_z_m_s", "height_m")
    }
    assert value == pytest.approx(
        {"roll_rad": np.radians(10), "pitch_rad": -np.radians(20), "yaw_rad": -np.radians(30), "q_rad_s": -1.0,
         "f_z_m_s2": 9.80665, "v_y_m_s": -2.0, "v_z_m_s": -3.0, "height_m": 4.0}
    )  # fmt: skip
    assert r.channel("yaw_rate_ref_rad_s")[1][0] == -1.0
    np.testing.assert_allclose(r.series["attitude"].t_s, t, atol=1e-9)


def test_enu_turns_vectors_and_yaw_and_a_missing_axis_costs_only_itself(tmp_path, t):
    one = 0 * t + 1.0
    r = mapped(
        tmp_path,
        "frame: {world: ENU}\ncolumns:\n  t_s: t\n  v_x_m_s: east\n  v_y_m_s: north\n  p_x_m: px\n  yaw_rad: yaw\n  roll_rad: yaw\n",
        t=t, east=2 * one, north=3 * one, px=t, yaw=0.25 * one,
    )  # fmt: skip
    assert r.channel("v_x_m_s")[1][0] == 3.0
    assert r.channel("v_y_m_s")[1][0] == -2.0
    assert r.channel("yaw_rad")[1][0] == pytest.approx(0.25 - np.pi / 2)
    np.testing.assert_allclose(r.channel("p_y_m")[1], -t)
    assert not r.has("p_x_m")


@pytest.mark.parametrize(
    ("world", "body"), [("NWU", "FLU"), ("NED", "FRD"), ("ENU", "FLU"), ("ENU", "FRD"), ("NED", "FLU")]
)
def test_quaternions_in_any_frames(tmp_path, t, world, body):
    rpy = np.stack([0.1 + 0 * t, -0.2 + 0 * t, 0.7 + 0.1 * np.sin(t)], axis=-1)
    half = np.array([0.0, 1.0, 0.0, 0.0])
    q = frames.quaternion_from_euler(rpy)
    if body == "FRD":
        q = frames.quaternion_multiply(q, half)
    if world == "NED":
        q = frames.quaternion_multiply(half, q)
    elif world == "ENU":
        q = frames.quaternion_multiply([np.cos(np.pi / 4), 0, 0, np.sin(np.pi / 4)], q)
    r = mapped(
        tmp_path,
        f"frame: {{world: {world}, body: {body}}}\ncolumns:\n  t_s: t\n  attitude: {{quaternion: ['q[3]', 'q[0]', 'q[1]', 'q[2]']}}\n",
        t=t, q=[str([x, y, z, w]) for w, x, y, z in q.tolist()],
    )  # fmt: skip
    for i, name in enumerate(("roll_rad", "pitch_rad", "yaw_rad")):
        np.testing.assert_allclose(r.channel(name)[1], rpy[:, i], atol=1e-12)
    assert "quaternion" in r.provenance.derived["roll_rad"]


def test_a_quaternion_that_flies_upside_down_is_refused(tmp_path, t):
    text = "frame: {body: FRD}\ncolumns:\n  t_s: t\n  attitude: {quaternion: [w, x, y, z]}\n"
    with pytest.raises(RecordingError, match="upside down") as caught:
        mapped(tmp_path, text, t=t, w=1.0, x=0.0, y=0 * t, z=0.0)
    assert "w, x, y, z" in caught.value.hint


def test_means_scales_offsets_constants_and_a_rate(tmp_path, t):
    r = mapped(
        tmp_path,
        "rate_hz: 50\ncolumns:\n  roll_rad: a\n  throttle: {mean: [m1, m2], scale: 0.001, offset: -1}\nconstants: {voltage_v: 22.2}\n",
        a=0 * t, m1=1400.0, m2=1600.0,
    )  # fmt: skip
    assert r.channel("throttle")[1][0] == pytest.approx(0.5)
    assert r.channel("voltage_v")[1][3] == 22.2
    np.testing.assert_allclose(r.series["attitude"].t_s, t)


def test_velocity_and_acceleration_are_derived_and_said(tmp_path, t):
    r = import_log(save(tmp_path / "a.csv", t_s=t, p_z_m=1.5 * t**2))
    np.testing.assert_allclose(r.channel("v_z_m_s")[1][2:-2], 3.0 * t[2:-2], atol=1e-9)
    np.testing.assert_allclose(r.channel("a_z_m_s2")[1][3:-3], 3.0, atol=1e-9)
    assert set(r.provenance.derived) == {"v_z_m_s", "a_z_m_s2", "height_m"}


def test_with_an_accelerometer_nothing_is_differentiated_into_it(tmp_path, t):
    assert not import_log(save(tmp_path / "a.csv", t_s=t, v_z_m_s=t, f_z_m_s2=9.81)).has("a_z_m_s2")


def test_slow_channels_keep_their_own_times(tmp_path, t):
    voltage = np.where(np.arange(N) % 10 == 0, 22.0 - t, np.nan)
    v = np.repeat(np.random.default_rng(1).normal(size=N // 4), 4)
    r = import_log(save(tmp_path / "a.csv", t_s=t, roll_rad=np.sin(t), voltage_v=voltage, v_x_m_s=v))
    assert len(r.series["battery"]) == N // 10
    assert r.series["velocity"].rate_hz == pytest.approx(12.5)
    assert len(r.series["attitude"]) == N


def test_a_step_column_numbers_legs(tmp_path, t):
    step = np.where(t < 1, 0, np.where(t < 2, 1, np.where(t < 3, 0, 2)))
    r = import_log(save(tmp_path / "a.csv", t_s=t, roll_rad=0 * t, step=step))
    assert [(m.kind, m.label, round(m.t_s, 2)) for m in r.markers] == [
        ("leg", "step 1", 1.0), ("phase", "end", 2.0), ("leg", "step 2", 3.0)
    ]  # fmt: skip


def test_steps_that_were_each_timed_from_their_own_start(tmp_path, t):
    two = np.concatenate([t, t])
    r = import_log(save(tmp_path / "a.csv", t_s=two, roll_rad=two))
    assert "time starts anew 1 times" in r.provenance.losses[0]
    assert len(r.series["attitude"]) == 2 * N
    assert np.max(np.diff(r.series["attitude"].t_s)) == pytest.approx(10.0)
    assert [m.label for m in r.markers] == ["step 1", "step 2"]


def test_a_clock_that_stepped_back_in_flight_makes_no_steps_of_the_pieces(tmp_path, t):
    jumped = np.where(t < 0.6 * t[-1], t, t - 0.1 * t[-1])
    assert jumped[np.flatnonzero(np.diff(jumped) < 0)[0] + 1] > 1.0
    r = import_log(save(tmp_path / "a.csv", t_s=jumped, roll_rad=t))
    assert "time starts anew 1 times" in r.provenance.losses[0], "and it is said"
    assert len(r.series["attitude"]) == N
    assert r.markers == ()


@pytest.mark.parametrize(
    ("columns", "words"),
    [
        ({"roll_rad": [0.0, 1.0]}, "no time"),
        ({"time": [0.0, 1.0], "x": [1.0, 2.0]}, "no column of this table is a channel"),
        ({"t_s": [1.0, 1.0], "roll_rad": [0.0, 1.0]}, "time stamps are the same"),
        ({"t_s": [1.0, None], "roll_rad": [0.0, 1.0]}, "usable values, too few"),
        ({"t_s": [0.0, 1.0], "roll_rad": ["a", "b"]}, "holds no numbers"),
        ({"t_s": [0.0, 1.0], "roll_rad": ["[1, 2]", "[1, 2]"]}, "name one cell"),
        ({"t_s": [0.0, 1.0], "voltage_v": [0.0, 1.0]}, "neither attitude nor"),
        ({"t_s": [0.0, 1.0], "roll_rad": [0.0, 0.0], "throttle": [1100, 1200]}, "from 0 to 1"),
    ],
)
def test_tables_that_cannot_be_used_are_refused_with_a_remedy(tmp_path, columns, words):
    with pytest.raises(RecordingError, match=words) as caught:
        import_log(save(tmp_path / "a.csv", **columns))
    assert "a.csv" in str(caught.value)


@pytest.mark.parametrize(
    "text", ["", "t_s,roll_rad\n", "\n\n\n", "t_s,t_s\n1,2\n3,4\n", "\x00\x01\x02,\n" * 5, '"a,b\n1,2\n3']
)
def test_broken_tables_are_refused(tmp_path, text):
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(RecordingError):
        import_log(tmp_path / "a.csv")


def test_lines_with_too_many_values_are_left_out_and_reported(tmp_path):
    (tmp_path / "a.csv").write_text("t_s,roll_rad\n0,0\n1,2,3\n2,0\n3,0\n")
    r = import_log(tmp_path / "a.csv")
    assert len(r.series["attitude"]) == 3
    assert r.provenance.losses == ("1 lines have too many values and were left out (the first is line 3)",)


def test_a_column_map_lists_all_its_problems_with_lines():
    text = (
        "format: columns/1\nframe: {world: ENUU}\ncolumns:\n  rol_rad: a\n  pitch_rad: {from: b, unit: degr}\n"
        "  throttle: {from: a, mean: [b]}\n  attitude: {quaternion: [a, b]}\nconstants: {volts: 3}\n"
    )
    with pytest.raises(RecordingError) as caught:
        parse_columns(text, "m.yaml")
    lines = str(caught.value).splitlines()
    assert [line.split(":")[1] for line in lines] == ["2", "4", "5", "6", "7", "8"]
    assert "did you mean `roll_rad`" in lines[1]
    assert "did you mean `deg`" in lines[2]


def test_the_map_in_the_documentation_is_one(repository):
    text = (repository / "docs" / "formats.md").read_text()
    block = next(b for b in text.split("```") if "format: columns/1" in b).removeprefix("yaml\n")
    columns = parse_columns(block)
    assert (columns.world, columns.body, columns.rate_hz) == ("ENU", "FRD", 100)
    assert columns.columns["v_x_m_s"].columns == ("vel[0]",)
    assert columns.filters_hz == {"specific_force": 20.0}


def test_a_column_that_is_not_there_is_named(tmp_path, t):
    with pytest.raises(RecordingError, match=r"no column 'rol'.*did you mean 'roll'"):
        mapped(tmp_path, "columns:\n  t_s: t\n  roll_rad: rol\n", t=t, roll=0 * t)


def test_the_shipped_maps_fit_the_real_tables(shared_data, repository):
    path = shared_data / "wind_tunnel" / "custom_figure8_NF-C_70wind.csv.gz"
    r = import_log(path, repository / "examples" / "columns" / "neural_fly.yaml")
    assert r.provenance.losses == ()
    # Head wind of 8.5 m/s along x: the nose is down, and the thrust times its sine holds the drag.
    assert 0.2 < np.median(r.channel("pitch_rad")[1]) < 0.4
    np.testing.assert_allclose(np.median(r.channel("roll_rad")[1] - r.channel("roll_ref_rad")[1]), 0.0, atol=0.02)


def test_a_weight_beside_a_motor_takes_it_to_its_limit(shared_data):
    """The accelerometer does not follow the thrust command there: 0.68 m/s^2 RMS, and 0.12 with each motor limited."""
    r = import_log(shared_data / "propeller_damage" / "controller_data" / "add_weight_W3_near_M3" / "E9_log02")
    assert any(loss.startswith("motor 3 was asked for up to 1.") for loss in r.provenance.losses)


def test_a_table_of_a_thrust_stand_is_refused_as_no_flight(shared_data, tmp_path):
    (tmp_path / "m.yaml").write_text("format: columns/1\ncolumns:\n  t_s: Time (s)\n  voltage_v: Voltage (V)\n")
    with pytest.raises(RecordingError, match="measurements of a thrust stand are not a flight"):
        import_log(shared_data / "thrust_stand" / "data" / "single_rotor" / "xNova-SR-ramp.csv", tmp_path / "m.yaml")


def test_bytes_of_any_kind_never_crash(attempt, tmp_path):
    rng = np.random.default_rng(3)
    buffer = io.BytesIO()
    pd.DataFrame({"t_s": np.arange(50) * 0.02, "roll_rad": 0.1, "throttle": 0.3}).to_parquet(buffer)
    text = pd.DataFrame({"t_s": np.arange(50) * 0.02, "roll_rad": 0.1, "throttle": 0.3}).to_csv(index=False).encode()
    for name, data in (("a.parquet", buffer.getvalue()), ("a.csv", text)):
        for _ in range(25):
            hurt = bytearray(data[: rng.integers(1, len(data))] if rng.random() < 0.3 else data)
            for place in rng.integers(0, len(hurt), rng.integers(1, 20)):
                hurt[place] = rng.integers(0, 256)
            (tmp_path / name).write_bytes(hurt)
            r = attempt(tmp_path / name)
            assert not isinstance(r, RecordingError) or name in str(r)


def test_whole_flights_one_after_another_are_no_steps(tmp_path):
    t = np.arange(1500) * 0.02
    r = import_log(save(tmp_path / "a.csv", t_s=np.concatenate([t, t]), roll_rad=0.1))
    assert r.markers == ()
    assert np.max(np.diff(r.series["attitude"].t_s)) == pytest.approx(10.0)


def test_a_step_number_that_never_changes_numbers_nothing(tmp_path, t):
    assert import_log(save(tmp_path / "a.csv", t_s=t, roll_rad=t, step=0)).markers == ()


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16"])
def test_commas_for_points_between_semicolons(tmp_path, t, encoding):
    frame = pd.DataFrame({"t_s": t, "roll_rad": 0.125, "v_x_m_s": -t})
    frame.to_csv(tmp_path / "Flug 1 – Wiese.csv", index=False, sep=";", decimal=",", encoding=encoding)
    r = import_log(tmp_path / "Flug 1 – Wiese.csv")
    assert r.channel("roll_rad")[1][0] == 0.125
    np.testing.assert_allclose(r.channel("v_x_m_s")[1], -t)


@pytest.mark.parametrize("name", ["a.csv", "a.parquet"])
def test_dates_for_times(tmp_path, t, name):
    frame = pd.DataFrame({"t_s": pd.Timestamp("2026-01-01") + pd.to_timedelta(t, unit="s"), "roll_rad": t})
    frame.to_csv(tmp_path / name, index=False) if name.endswith("csv") else frame.to_parquet(tmp_path / name)
    np.testing.assert_allclose(import_log(tmp_path / name).series["attitude"].t_s, t, atol=1e-6)


def test_an_index_is_a_column_too(tmp_path, t):
    pd.DataFrame({"t_s": t, "roll_rad": t}).set_index("t_s").to_parquet(tmp_path / "a.parquet")
    np.testing.assert_allclose(import_log(tmp_path / "a.parquet").series["attitude"].t_s, t)


def test_lines_of_zero_bytes_are_left_out_and_reported(tmp_path, t):
    text = save(tmp_path / "a.csv", t_s=t, roll_rad=t).read_text()
    (tmp_path / "a.csv").write_text(text[:1000] + "\0" * 300 + text[1300:])
    r = import_log(tmp_path / "a.csv")
    assert N - 60 < len(r.series["attitude"]) < N
    assert "zero bytes" in r.provenance.losses[0]


@pytest.mark.parametrize(
    ("factor_t", "factor_roll", "words"), [(1e3, 1.0, "name the unit"), (1.0, 57.3, "for degrees give `unit: deg`")]
)
def test_units_that_cannot_be_meant_are_refused(tmp_path, t, factor_t, factor_roll, words):
    with pytest.raises(RecordingError, match=words):
        import_log(save(tmp_path / "a.csv", t_s=t * factor_t, roll_rad=0.3 * np.sin(t) * factor_roll))


def test_a_scale_of_zero_is_refused():
    with pytest.raises(RecordingError) as caught:
        parse_columns("format: columns/1\ncolumns:\n  t_s: t\n  roll_rad: {from: r, scale: 0.0}\n", "map.yaml")
    (problem,) = caught.value.problems
    assert (problem.line, problem.path) == (4, "columns.roll_rad.scale")
    assert "every value of roll_rad the same" in problem.what
    assert "`constants:`" in problem.hint


def test_a_channel_has_one_source_and_a_filter_lets_something_through():
    text = "format: columns/1\ncolumns: {t_s: t, throttle: u}\nconstants: {throttle: 0.3}\nfilters_hz: {rates: -3}\n"
    with pytest.raises(RecordingError) as caught:
        parse_columns(text, "map.yaml")
    assert {p.path for p in caught.value.problems} == {"constants.throttle", "filters_hz.rates"}


def test_tables_that_were_joined_with_their_lines_of_names_and_units(tmp_path):
    t = np.arange(1500) * 0.02
    text = save(tmp_path / "a.csv", t_s=t, roll_rad=np.sin(t)).read_text()
    names, rest = text.split("\n", 1)
    one = f"{names}\ns,rad\n{rest}"
    (tmp_path / "a.csv").write_text(one + one)
    attitude = import_log(tmp_path / "a.csv").series["attitude"]
    np.testing.assert_allclose(attitude.t_s, np.concatenate([t, t + t[-1] + 10.0]))
    np.testing.assert_allclose(attitude.columns["roll_rad"], np.sin(np.concatenate([t, t])))


def motors(tmp_path, t, entry):
    """Throttle of two motors through a map entry."""
    path = tmp_path / "m.csv"
    v = np.sin(t)
    columns = {"t_s": t, "m1": 100.0 + 0 * t, "m2": 300.0 + 0 * t, "v_x_m_s": v, "v_y_m_s": v, "v_z_m_s": v}
    np.savetxt(path, np.stack(list(columns.values()), axis=1), delimiter=",", header=",".join(columns), comments="")
    text = f"format: columns/1\ncolumns:\n  t_s: t_s\n  v_x_m_s: v_x_m_s\n  v_y_m_s: v_y_m_s\n  v_z_m_s: v_z_m_s\n  throttle: {entry}\n"
    (tmp_path / "map.yaml").write_text(text)
    return float(import_log(path, tmp_path / "map.yaml").channel("throttle")[1][0])


@pytest.mark.parametrize(("above", "known"), [("{}", True), ("made by hand\n{}", True), ("t_s", False)])
def test_names_in_the_comment_above_the_numbers_are_those_of_the_columns(tmp_path, t, above, known):
    """numpy.savetxt writes them there: the first row of numbers was taken for the names."""
    columns = {"t_s": t, "roll_rad": np.sin(t), "pitch_rad": 0.1 * t}
    rows = np.stack(list(columns.values()), axis=1)
    np.savetxt(tmp_path / "a.csv", rows, delimiter=",", header=above.format(",".join(columns)))
    if not known:
        with pytest.raises(RecordingError):
            import_log(tmp_path / "a.csv")
        return
    attitude = import_log(tmp_path / "a.csv").series["attitude"]
    np.testing.assert_allclose(attitude.t_s, t)
    np.testing.assert_allclose(attitude.columns["roll_rad"], np.sin(t))


@pytest.mark.parametrize("separator", [",", " ", "   ", "\t"])
def test_a_table_without_a_line_of_names_is_read_by_the_numbers_of_its_columns(tmp_path, t, separator):
    """Its first row was taken for the names ("no column of this table is a channel (0.003, nan, nan.1, ...)"), and a map of it had to name
    columns by the numbers in them; columns parted by blanks were one."""
    rows = np.stack([t, np.sin(t), 0.1 * t], axis=1)
    np.savetxt(tmp_path / "a.txt", rows, fmt="%.6f", delimiter=separator)
    with pytest.raises(RecordingError) as refused:
        import_log(tmp_path / "a.txt")
    assert "called c1 to c3" in refused.value.hint
    (tmp_path / "map.yaml").write_text("format: columns/1\ncolumns: {t_s: c1, roll_rad: c2, pitch_rad: c3}\n")
    recording = import_log(tmp_path / "a.txt", tmp_path / "map.yaml")
    np.testing.assert_allclose(recording.channel("roll_rad")[1], np.sin(t), atol=1e-6)
    assert any("no line of names" in loss for loss in recording.provenance.losses)


def test_columns_that_are_named_by_counting_keep_these_names(tmp_path, t):
    pd.DataFrame({"0": t, "1": np.sin(t)}).to_csv(tmp_path / "a.csv", index=False)
    (tmp_path / "map.yaml").write_text('format: columns/1\ncolumns: {t_s: "0", roll_rad: "1"}\n')
    np.testing.assert_allclose(import_log(tmp_path / "a.csv", tmp_path / "map.yaml").channel("roll_rad")[1], np.sin(t))


def test_names_above_columns_that_are_parted_by_blanks(tmp_path, t):
    """What numpy.savetxt writes unless it is asked for commas."""
    np.savetxt(tmp_path / "a.txt", np.stack([t, np.sin(t)], axis=1), header="t_s roll_rad")
    np.testing.assert_allclose(import_log(tmp_path / "a.txt").channel("roll_rad")[1], np.sin(t))


def test_rotor_speeds_are_squared_motor_by_motor(tmp_path, t):
    assert motors(tmp_path, t, "{mean: [m1, m2], power: 2, scale: 1.0e-5}") == pytest.approx(0.5)


def test_motor_commands_go_through_a_table_one_by_one(tmp_path, t):
    pairs = "[[0, 0], [200, 0.1], [400, 0.9]]"
    assert motors(tmp_path, t, f"{{mean: [m1, m2], table: {pairs}}}") == pytest.approx((0.05 + 0.5) / 2)


def test_a_thrust_stand_is_a_table(tmp_path, t):
    command = np.linspace(0.0, 400.0, 4000)
    stand = np.stack([command, 2e-5 * command**2 + 0.01 * np.cos(7.0 * np.arange(4000))], axis=1)
    np.savetxt(tmp_path / "stand.csv", stand, delimiter=",", header="signal,thrust", comments="")
    entry = "{mean: [m1, m2], table: {file: stand.csv, input: signal, output: thrust}, scale: 0.5}"
    assert motors(tmp_path, t, entry) == pytest.approx(0.5, rel=0.02)


@pytest.mark.parametrize(
    ("entry", "words"),
    [
        ("{from: m1, table: [[1, 0], [0, 1]]}", "increasing"),
        ("{from: m1, table: {file: no.csv, input: a, output: b}}", "no.csv"),
        ("{from: m1, table: {file: m.csv, input: m1}}", "output is missing"),
        ("{from: m1, table: {file: m.csv, input: m1, output: m2}}", "fewer than two values"),
        ("{from: m1, power: 0}", "power"),
    ],
)
def test_tables_of_inputs_that_cannot_be_are_refused(tmp_path, t, entry, words):
    with pytest.raises(RecordingError, match=words):
        motors(tmp_path, t, entry)


def test_times_that_are_no_numbers_are_dropped_without_a_warning(tmp_path, recwarn):
    """Two infinite times in a row, and times with gaps between all of them."""
    t = np.arange(100) * 0.02
    endless = np.where((t > 0.5) & (t < 0.55), np.inf, t)
    found = import_log(save(tmp_path / "a.csv", t_s=endless, roll_rad=t)).series["attitude"]
    assert np.all(np.isfinite(found.t_s))
    assert 95 < len(found) < 100
    import_log(save(tmp_path / "b.csv", t_s=np.where(np.arange(100) % 2, np.nan, t), roll_rad=t))
    assert not [w for w in recwarn if w.category is RuntimeWarning]
