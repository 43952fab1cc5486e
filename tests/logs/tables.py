"""Tables of one's own making."""

import pandas as pd

from flighttest.logs import import_log

N = 200


def save(path, **columns):
    pd.DataFrame(columns).to_csv(path, index=False)
    return path


def mapped(tmp_path, text, **columns):
    (tmp_path / "map.yaml").write_text("format: columns/1\n" + text)
    return import_log(save(tmp_path / "a.csv", **columns), tmp_path / "map.yaml")
