import numpy as np
import pytest
from pymavlink import DFReader

from flighttest.logs.ardupilot.dataflash import read_dataflash
from flighttest.logs.opening import LogFile


def pieces(data, size):
    return [bytes(data[i : i + size]) for i in range(0, len(data), size)]


def test_every_format_letter_is_read_with_its_scale(dataflash):
    w = dataflash()
    w.format("PLN", "QbBhHiIfdgn", ",".join(f"F{i}" for i in range(11)))
    w.format("SCL", "cCeELMqNZ", ",".join(f"F{i}" for i in range(9)))
    plain = (2**60, -5, 250, -3000, 60000, -70000, 4000000000, 1.5, 2.25, 0.5)
    w.write("PLN", *plain, "ab")
    w.write("SCL", -123, 456, -78900, 78901, -1234567890, 20, -(2**50), "INS_ACCEL_FILTER", "hello\0rest")
    tables = read_dataflash([bytes(w.data)]).tables
    assert [tables["PLN"].get(f"F{i}")[0] for i in range(10)] == list(plain)
    assert tables["PLN"].text("F10") == ["ab"]
    scaled = [tables["SCL"].get(f"F{i}")[0] for i in range(7)]
    assert scaled == [-1.23, 4.56, -789.0, 789.01, -123.456789, 20, -(2**50)]
    assert tables["SCL"].text("F7") == ["INS_ACCEL_FILTER"]
    assert tables["SCL"].text("F8") == ["hello"]


def test_the_cut_of_the_pieces_does_not_matter(flight):
    data = bytes(flight(0.5).data)
    whole = read_dataflash([data])
    for size in (1, 7, 64, 1000):
        parts = read_dataflash(pieces(data, size))
        assert parts.gaps == whole.gaps == ()
        assert parts.tables.keys() == whole.tables.keys()
        for name, table in whole.tables.items():
            for field, values in table.raw.items():
                np.testing.assert_array_equal(parts.tables[name].raw[field], values)


def test_a_header_inside_a_payload_is_no_message(dataflash):
    w = dataflash()
    w.format("ONE", "QZ", "TimeUS,Text")
    for k in range(5):
        w.write("ONE", k, b"\xa3\x95\x0b" * 10)
    log = read_dataflash([bytes(w.data)])
    assert len(log.tables["ONE"]) == 5
    assert log.gaps == ()


def test_lost_bytes_cost_only_their_message_and_are_located(flight):
    data = bytearray(flight(0.5).data)
    whole = read_dataflash([bytes(data)])
    places = whole.tables["IMU"].at[[10, 40]]
    del data[int(places[1]) + 9 : int(places[1]) + 14]
    data[int(places[0])] = 0
    log = read_dataflash([bytes(data)])
    assert len(whole.tables["IMU"]) - len(log.tables["IMU"]) == 2
    assert 2 <= len(log.gaps) <= 3
    assert any(gap.offset <= places[0] < gap.offset + gap.size for gap in log.gaps)
    assert sum(len(t) for t in whole.tables.values()) - sum(len(t) for t in log.tables.values()) <= 4
    assert sum(gap.size for gap in log.gaps) < 200


def test_a_truncated_log_is_read_to_its_last_whole_message(flight):
    data = bytes(flight(0.5).data)
    log = read_dataflash([data[:-5]])
    assert log.gaps[-1].offset + log.gaps[-1].size == len(data) - 5
    whole = read_dataflash([data])
    assert sum(map(len, whole.tables.values())) - sum(map(len, log.tables.values())) == 1


def test_only_what_is_wanted_is_kept(flight):
    log = read_dataflash([bytes(flight(0.2).data)], {"IMU": ("TimeUS", "AccZ"), "NONE": None})
    assert set(log.tables) == {"IMU"}
    assert set(log.tables["IMU"].raw) == {"TimeUS", "AccZ"}


def test_messages_without_a_format_are_reported_and_cost_no_others(dataflash):
    w = dataflash()
    w.format("ONE", "Qf", "TimeUS,Value")
    for k in range(20):
        w.write("ONE", k, 1.0)
        w.data += b"\xa3\x95\xc8" + bytes(9)
    w.write("ONE", 20, 1.0)
    log = read_dataflash([bytes(w.data)])
    assert len(log.tables["ONE"]) == 21
    assert "20 messages of type 200" in log.notes[0]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["copter_3.2_2014.BIN", "copter_3.4_mechanical_failure.bin", "sitl_4.7dev_steps.BIN"])
def test_values_are_identical_to_pymavlinks(shared_data, name):
    path = shared_data / "arducopter_logs" / name
    log = read_dataflash(LogFile(path).pieces())
    assert log.gaps == ()
    theirs = DFReader.DFReader_binary(str(path))
    seen: dict[str, int] = {}
    checked = 0
    while (message := theirs.recv_match()) is not None:
        kind = message.get_type()
        row = seen.get(kind, 0)
        seen[kind] = row + 1
        # All messages are counted, every 23rd is compared field by field.
        if checked % 23 == 0 and kind not in ("FILE", "ISBD"):
            table = log.tables[kind]
            for field in table.raw:
                expected = getattr(message, field)
                if isinstance(expected, str):
                    value = table.raw[field][row].split(b"\0")[0]
                    assert value in (expected.encode("utf-8"), expected.encode("latin-1")), (kind, field)
                else:
                    np.testing.assert_array_equal(
                        _one(table, field, row), np.asarray(expected, dtype=float), f"{kind}.{field}"
                    )
        checked += 1
    assert {kind: n for kind, n in seen.items() if kind in log.tables} == {k: len(t) for k, t in log.tables.items()}


def _one(table, field, row):
    value = np.asarray(table.raw[field][row], dtype=float)
    divisor = table.format.divisor(field)
    return value if divisor == 1.0 else value / divisor
