"""Windows that are slow on average are refused for their bin table, with the reason of the page."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from paper_class import WINDOWS
from smooth_wheelset import alignment, mems_windows, run, track

import estimation
from api.app import document_text
from estimation.motion.window_motion import window_motion
from estimation.tables.bin_table import cells_of_window
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.windows import Window

known = alignment(track(1))
window = mems_windows(run(60, seed=1, cone=0.12, swing=4.0), seed=1)[0]


def partly_slow(fast: float) -> Window:
    """Return the window at 6 m/s for its first half and faster in its second."""
    count = len(window.valid)
    speed = np.where(np.arange(count) < count // 2, 6.0, fast)
    return replace(window, speed=speed, distance=window.distance[0] + np.cumsum(speed) * window.sample_interval_s)


refused = cells_of_window(partly_slow(9.9), known, WINDOWS)
assert isinstance(refused, Reason), refused
assert refused.code is ReasonCode.SLOW_ON_AVERAGE, refused
assert "7.95 m/s on average, at least 8 m/s" in refused.text, refused
assert not isinstance(window_motion(partly_slow(9.9), known, WINDOWS), Reason)
assert not isinstance(cells_of_window(partly_slow(10.1), known, WINDOWS), Reason)
assert '"slow_on_average"' in document_text()
print(estimation.__file__)  # noqa: T201 - for the test: which copy ran
