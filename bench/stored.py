"""What a wheelset keeps of a year, by kind, before and after a purge with the days that are shipped.

Windows of a simulated recording go through receiver and jobs, and are put again over a year: ``WINDOWS_A_DAY`` of the
960 that 16 hours of running have, over the 960 km of these hours at 60 km/h. Roll-ups, geometries, trends, purge and
sealing are the real ones. Bytes that there are per window are scaled by 960 to ``WINDOWS_A_DAY``; roll-ups are not, for
there is one per 1,000 km. Of geometries and trends the bytes of a version are counted as often as their jobs make one:
each run of 16 hours while every version is kept, and one a day before.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Iterator, Mapping
from pathlib import Path

from bench.report import BenchRow, row_bench
from bench.wheelset_recording import recorded_year
from bench.wheelset_year import HOURS_A_DAY, SERIAL, WINDOWS_A_DAY
from fleet_db.keeping.purge import purge
from fleet_db.keeping.retention import Retention
from fleet_db.keeping.stored_bytes import database_size
from fleet_db.packed_values import pack_geometry
from fleet_db.raw import FileRawStore
from fleet_db.storage import SqlStorage

DAYS, ALL_A_DAY = 365, 960
DAYS_AFTER = 10  # of them, after the purge
MB = 1e6
REACH_MB = 200.0
RESULTS_A_RUN = 3  # the current geometry, that of the newest interval, and the trend
JOB_S = 900.0
PER_WINDOW = {
    "samples of windows": (),
    "bin tables": ("window_bin_tables",),
    "windows": ("windows", "window_positions", "track_epoch_windows"),
}
PER_INTERVAL = {"roll-ups": ("roll_ups", "roll_up_states", "rolling_sums", "window_due")}
Bytes = Mapping[str, float]


def rows(_options: argparse.Namespace, folder: Path) -> Iterator[BenchRow]:
    """Yield the bytes of a wheelset and year by kind, before and after the purge."""
    with recorded_year(folder) as year:
        storage, end_ns = year.storage, year.put(1, DAYS - DAYS_AFTER)
        before, geometry = _bytes(storage, Retention(every_estimate=None)), _current(storage)
        cpu_s = _purge(storage, end_ns)
        _purge(storage, year.put(DAYS - DAYS_AFTER + 1, DAYS))
        after, same = _bytes(storage, Retention()), geometry <= _current(storage)
        young = _of_the_last_days(storage)
    yield from _report(before, after, young, same=same)
    yield BenchRow("purge of the year", f"{cpu_s:.1f} CPU s", "", met=True)


def _purge(storage: SqlStorage, now_ns: int) -> float:
    """Purge with the shipped days; return its CPU seconds. The files are as old as their windows then."""
    for path in storage.data_dir.rglob("*.window"):
        os.utime(path, (1e9, 1e9))
    clock = time.process_time()
    purge(storage, FileRawStore(storage.data_dir / "raw"), Retention(), now_ns, lambda: None)
    return time.process_time() - clock


def _report(before: Bytes, after: Bytes, young: Bytes, *, same: bool) -> Iterator[BenchRow]:
    for kind in before:
        left = after[kind] - young.get(kind, 0.0)
        shown = f"{before[kind] / MB:,.1f} -> {after[kind] / MB:,.1f} MB, of which for good {left / MB:,.1f} MB"
        yield BenchRow(f"a wheelset and year: {kind}", shown, "", met=True)
    whole, left = sum(after.values()), sum(after.values()) - sum(young.values())
    yield BenchRow(
        "a year leaves behind when its days of retention are over",
        f"{left / MB:,.1f} MB",
        "200 MB",
        left < REACH_MB * MB,
    )
    yield BenchRow(
        f"all that a wheelset keeps after a year, of {sum(before.values()) / MB:,.0f} MB",
        f"{whole / MB:,.1f} MB",
        "200 MB",
        whole < REACH_MB * MB,
    )
    yield BenchRow("geometry before and after", "the same" if same else "differs", "the same", met=same)


def _bytes(storage: SqlStorage, retention: Retention) -> dict[str, float]:
    """Return the bytes of a wheelset and year by kind."""
    with storage.read() as unit:
        tables = database_size(unit.connection, 1 << 40).tables
    scale = ALL_A_DAY / WINDOWS_A_DAY
    size = {name: float(one.table_bytes + one.index_bytes) for name, one in tables.items()}
    found = {kind: scale * sum(size[name] for name in names) for kind, names in PER_WINDOW.items()}
    found["samples of windows"] = scale * sum(path.stat().st_size for path in storage.data_dir.rglob("*.window"))
    found |= {kind: sum(size[name] for name in names) for kind, names in PER_INTERVAL.items()}
    every_days = DAYS if retention.every_estimate is None else retention.every_estimate
    versions = RESULTS_A_RUN * (every_days * HOURS_A_DAY * 3600 / JOB_S + DAYS - every_days)
    return found | {"results": versions * size["results"] / max(tables["results"].rows, 1)}


def _of_the_last_days(storage: SqlStorage) -> dict[str, float]:
    """Return the bytes that go when the days of retention of what is there are over."""
    kept = _bytes(storage, Retention())
    with storage.read() as unit:
        tables = database_size(unit.connection, 1 << 40).tables
        rows_of = {name: tables[name].table_bytes + tables[name].index_bytes for name in PER_WINDOW["windows"]}
    once = _bytes(storage, Retention(every_estimate=1e-9))
    places = rows_of["window_positions"] + rows_of["track_epoch_windows"]
    return {
        "samples of windows": kept["samples of windows"],
        "bin tables": kept["bin tables"],
        "windows": places * ALL_A_DAY / WINDOWS_A_DAY,
        "results": kept["results"] - once["results"],
    }


def _current(storage: SqlStorage) -> frozenset[tuple[int | None, bytes]]:
    """Return the geometries of the intervals that are over, as they are stored."""
    with storage.read() as unit:
        found = unit.geometries.intervals(SERIAL)
    return frozenset((one.interval, pack_geometry(one.geometry)) for one in found[: DAYS - DAYS_AFTER - 20])


main = row_bench("stored", "Bytes of a wheelset and year", __doc__, rows).run
