"""Dataflash logs written out as text are read as the logs that they were made from."""

import numpy as np
import pytest

from flighttest.logs import import_log
from flighttest.logs.ardupilot.dataflash import read_dataflash
from flighttest.logs.ardupilot.text_log import messages
from flighttest.logs.opening import LogFile

DECLARED = """FMT, 128, 89, FMT, BBnNZ, Type,Length,Name,Format,Columns
FMT, 163, 27, ATT, QccccCCCC, TimeUS,DesRoll,Roll,DesPitch,Pitch,DesYaw,Yaw,ErrRP,ErrYaw
FMT, 169, 14, MODE, QMBB, TimeUS,Mode,ModeNum,Rsn
FMT, 134, 75, MSG, QZ, TimeUS,Message
"""


def tables(text):
    return read_dataflash(messages([text.encode()])).tables


def test_fields_are_what_they_mean():
    found = tables(DECLARED + "ATT, 42941150, -0.0800000000000002, 0.51, 0, 1, 356.93000000000001, 356.94, 0, 0\n")[
        "ATT"
    ]
    assert found.get("TimeUS") == [42941150]
    got = [found.get(f)[0] for f in ("DesRoll", "Roll", "DesYaw", "Yaw")]
    np.testing.assert_allclose(got, [-0.08, 0.51, 356.93, 356.94])


@pytest.mark.parametrize(("mode", "number"), [("4", 4), ("Loiter", 5), ("GUIDED_NOGPS", 20)])
def test_a_mode_is_a_number_or_a_name(mode, number):
    assert tables(f"{DECLARED}MODE, 1, {mode}, {number}, 2\n")["MODE"].get("Mode") == [number]


@pytest.mark.parametrize(
    "line", ["ATT, 1, 2", "NONE, 1", "MODE, 1, No such, 4, 2", "ATT, x, 0, 0, 0, 0, 0, 0, 0, 0", ""]
)
def test_a_line_that_is_no_message_is_left_out(line):
    found = tables(f"{DECLARED}{line}\nMSG, 5, a text, with commas\n")
    assert "ATT" not in found
    assert "MODE" not in found
    assert found["MSG"].text("Message") == ["a text, with commas"]


@pytest.mark.slow
def test_a_whole_log_as_text_is_the_same_recording(repository, tmp_path):
    path = repository / "tests" / "data" / "sitl.BIN.xz"
    log = read_dataflash(LogFile(path).pieces())
    lines = []
    for name, table in log.tables.items():
        if "a" in table.format.codes:
            continue
        columns = [
            table.text(f) if table.raw[f].dtype.kind == "S" else [f"{v:.17g}" for v in table.get(f)]
            for f in table.format.fields
        ]
        lines += [
            (int(at), ", ".join((name, *row))) for at, row in zip(table.at, zip(*columns, strict=True), strict=True)
        ]
    text = tmp_path / "a.log"
    text.write_text("\n".join(line for _, line in sorted(lines)))
    made, known = import_log(text), import_log(path)
    assert made.series.keys() == known.series.keys()
    for group, series in known.series.items():
        np.testing.assert_allclose(made.series[group].t_s, series.t_s, atol=1e-9)
        for channel, values in series.columns.items():
            np.testing.assert_allclose(
                made.series[group].columns[channel], values, rtol=1e-6, atol=1e-6, err_msg=channel
            )
