"""Windows that follow each other without a break as one, however many: long wavelengths need long segments."""

from __future__ import annotations

import sys
from collections.abc import Iterable

from estimation.track.passes import following, joined
from estimation.values.windows import Window


def whole_runs(windows: Iterable[Window]) -> list[Window]:
    parts = list(windows)
    keys = [
        (
            (w.wheelset, w.vehicle, w.axle, w.track_section, w.sample_interval_s, w.backwards),
            w.start_ns,
            w.start_ns + w.length_ns,
        )
        for w in parts
    ]
    return [joined(run) for run in following(parts, keys, sys.maxsize)]
