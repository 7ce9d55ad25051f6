"""What one new window of a wheelset with a year of history costs: geometry, trend, alerts; in a process of its own."""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from statistics import median

from sqlalchemy import select

from api.factory import open_store
from api.pipeline import job_context
from api.settings import Settings
from bench.counting import asked, run
from bench.report import BenchRow, row_bench
from bench.standing_clock import StandingClock
from bench.wheelset_year import SERIAL, Original, WheelsetYear
from estimation.jobs.catalogue import job_named
from estimation.values.geometry import GEOMETRY
from estimation.values.runs import JobTrigger
from fleet_db.rows import table_of
from fleet_db.storage import SqlStorage
from fleet_db.stores.geometries import INTERVALS
from fleet_db.tables.windows import WindowRow

DAYS, WINDOWS = 365, 11
JOBS = ("refresh_geometry", "refresh_trends", "evaluate_alerts")
REACH_S, REACH_MB = 0.08, 300.0
MB_OF_KIB, LEASE_S = 1024.0, 60.0
START = table_of(WindowRow).c.start_ns


def rows(_options: argparse.Namespace, folder: Path) -> Iterator[BenchRow]:
    """Yield CPU time, statements and peak memory of the jobs that follow a new window."""
    from bench.wheelset_recording import recorded_year  # noqa: PLC0415 - not in the process that is measured: it has no simulator

    with recorded_year(folder) as year:
        year.put(1, DAYS)
        command = [sys.executable, "-m", "bench.new_window", str(year.storage.data_dir)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)  # noqa: S603 - this program
    found = json.loads(done.stdout)
    yield BenchRow("intervals of the wheelset", str(found["intervals"]), "", met=True)
    for name in JOBS:
        spent = median(found["cpu_s"][name])
        shown = f"{spent:.3f} CPU s ({min(found['cpu_s'][name]):.3f} to {max(found['cpu_s'][name]):.3f})"
        shown += f", {median(found['statements'][name]):.0f} statements"
        reach = REACH_S if name == JOBS[0] else None
        yield BenchRow(
            f"{name} after one new window, median of {WINDOWS}",
            shown,
            "" if reach is None else f"< {reach} CPU s",
            met=reach is None or spent < reach,
        )
    peak = found["peak_mb"]
    yield BenchRow("peak memory of the process", f"{peak:.0f} MB", f"< {REACH_MB:.0f} MB", met=peak < REACH_MB)


def measured(settings: Settings) -> dict[str, object]:
    """Return what each job cost after each of some windows that were put one at a time."""
    # as every command of ours runs jobs: under a lease
    with closing(open_store(settings)) as store, store.owned(JobTrigger.CLI, "bench", LEASE_S) as storage:
        context = job_context(settings, storage)
        cpu_s: dict[str, list[float]] = {name: [] for name in JOBS}
        statements: dict[str, list[int]] = {name: [] for name in JOBS}
        with storage.read() as unit:
            own = select(START).where(table_of(WindowRow).c.wheelset == SERIAL)
            starts = sorted(unit.connection.scalars(own.order_by(START.desc()).limit(WINDOWS + 1)))
            intervals = len(unit.results.numbers(GEOMETRY, {SERIAL: INTERVALS}))
        year = WheelsetYear(context, storage, ())
        for number, start_ns in enumerate(starts):
            year.originals = [_original(storage, start_ns)]  # one at a time: the jobs have none of them in memory
            with storage.write() as unit:
                at_ns = year.put_window(unit, 1, number).record.start_ns
            at = replace(context, clock=StandingClock(at_ns))
            for name in JOBS:
                began = time.process_time()
                with asked() as found:
                    run(job_named(name), at)
                if number:  # the first compiles and imports
                    cpu_s[name].append(time.process_time() - began)
                    statements[name].append(found.statements)
    return {"cpu_s": cpu_s, "statements": statements, "intervals": intervals, "peak_mb": _peak_mb()}


def _peak_mb() -> float:
    """Return the largest memory of this process, MB; ``getrusage`` counts that of the process that started it, too."""
    lines = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("VmHWM:")) / MB_OF_KIB


def _original(storage: SqlStorage, start_ns: int) -> Original:
    with storage.read() as unit:
        record, table, version = next(iter(unit.tables.stream(SERIAL, start_ns, start_ns + 1)))
        return Original(unit.windows.load(SERIAL, record.start_ns), table, version)


main = row_bench("new_window", "One new window after a year", __doc__, rows).run


if __name__ == "__main__":
    print(json.dumps(measured(Settings(data_dir=Path(sys.argv[1]), database_url=None, _env_file=None))))
