"""A specific force in g, with z down, or that is none is reported."""

import numpy as np
import pytest

from tests.logs.tables import N, mapped


@pytest.fixture
def t():
    return np.arange(N) * 0.02


@pytest.mark.parametrize(
    ("frame", "factor", "words"),
    [
        ("", 1.0, ()),
        ("", 1 / 9.81, ("`unit: g`",)),
        ("", 1 / 6.0, ("hold something else",)),
        ("", 100.0, ("have another unit",)),
        ("", 2.0, ()),
        ("", -1.0, ("write `frame: {body: FRD}`",)),
        ("", -1 / 9.81, ("`unit: g`", "write `frame: {body: FRD}`")),
        ("frame: {body: FRD}\n", -1.0, ()),
        ("frame: {body: FRD}\n", 1.0, ("leave that out",)),
    ],
)
def test_an_accelerometer_in_another_unit_or_frame_is_reported(tmp_path, t, frame, factor, words):
    columns = "columns: {t_s: t, roll_rad: r, f_x_m_s2: x, f_y_m_s2: y, f_z_m_s2: z}\n"
    wave = np.sin(7 * t)
    r = mapped(
        tmp_path,
        frame + columns,
        t=t,
        r=0.1 * wave,
        x=factor * wave,
        y=0.5 * factor * wave,
        z=factor * (9.81 + 3 * wave),
    )
    assert len(r.provenance.losses) == len(words)
    for loss, word in zip(r.provenance.losses, words, strict=True):
        assert word in loss
