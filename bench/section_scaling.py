"""Time and memory of the alignment job by its number of passes, each in a fresh process on one core."""

from __future__ import annotations

import resource
import tempfile
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import closing
from dataclasses import replace
from itertools import pairwise
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from api.comparison.trial import ESTIMATION, deploy, opened, receive, record, run_jobs
from api.factory import open_store
from api.settings import Settings
from ingest.simulator.drawn_fleet import with_seed
from ingest.simulator.scenario import Scenario
from ingest.simulator.scenario_file import load_scenario

SIZES = ((12, 4, 3), (24, 8, 3), (48, 16, 3), (96, 16, 6))  # passes, wheelsets, campaigns
ROW = "unknown_position"
MIB = 1024.0  # KiB
VEHICLES = 4


def scaling(keep: Path | None) -> Iterator[dict[str, Any]]:
    """Yield one result a size; recordings stay in ``keep`` where it is given."""
    with tempfile.TemporaryDirectory(prefix="treadwatch-scaling-") as folder:
        for passes, wheelsets, campaigns in SIZES:
            scenario = sized(wheelsets, campaigns)
            data = Path(folder) / f"{passes}"
            settings = deploy(scenario, data)
            receive(record(scenario, keep or Path(folder) / "recordings"), settings)
            with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
                yield {"passes": passes, **pool.submit(measured, settings).result()}


def sized(wheelsets: int, campaigns: int) -> Scenario:
    """Return the scenario with as many wheelsets, spread over the wear, and campaigns."""
    scenario = load_scenario(ROW)
    assert scenario.drawn is not None
    drawn = replace(scenario.drawn, given_vehicles=VEHICLES, wheelsets=wheelsets // VEHICLES)
    return with_seed(replace(scenario, drawn=drawn, sessions=replace(scenario.sessions, campaigns=campaigns)), 0)


def measured(settings: Settings) -> dict[str, Any]:
    """Return time and peak memory of the jobs; in a process of its own, else the peak is that of another."""
    with closing(open_store(settings)):
        base = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / MIB
    clock = [time.process_time()]
    with opened(settings) as (_, context):
        for job in ESTIMATION:
            run_jobs(context, [job])
            clock.append(time.process_time())
    parts = [after - before for before, after in pairwise(clock)]
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / MIB
    return {"parts": parts, "seconds": sum(parts), "peak_mib": peak, "base_mib": base}
