"""Height above the ground of a rangefinder that does not read all the time."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from flighttest.recording import Series

FloatArray = NDArray[np.float64]

_MOST_READ = 0.99  # of the samples: what is read off otherwise is then not worth a remark


def ranged_height(
    t_s: FloatArray, ranged_m: FloatArray, good: NDArray[np.bool_], position: Series | None
) -> tuple[FloatArray, str]:
    """Height above ground (n,), and how it was completed ('' where it was not).

    t_s, ranged_m: (n,) times and readings; good: (n,) which of them hold. Beyond the reach of the rangefinder the height is that of
    `p_z_m`, level with its readings before and after, as over level ground; NaN where there is none.
    """
    height = np.where(good, ranged_m, np.nan)
    if good.all() or position is None:
        return height, ""
    known = np.isfinite(position.columns["p_z_m"])
    if np.count_nonzero(known) < 2 or not good.any():
        return height, ""
    up = np.interp(t_s, position.t_s[known], position.columns["p_z_m"][known], left=np.nan, right=np.nan)
    level = good & np.isfinite(up)
    if not level.any():
        return height, ""
    ground = np.interp(t_s, t_s[level], (up - ranged_m)[level])
    share = float(np.mean(good))
    remark = f"the rangefinder for {100 * share:.0f} % of its samples; where it does not read, p_z_m, level with its readings"
    return np.where(good, height, up - ground), remark if share < _MOST_READ else ""
