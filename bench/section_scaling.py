"""Time and memory of a section by its number of passes, each in a fresh process on one core."""

from __future__ import annotations

import resource
import tempfile
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from ingest.simulator.section_file import load_section_scenario
from ingest.simulator.section_run import SectionRun, simulate_section

SIZES = ((12, 4, 3), (24, 8, 3), (48, 16, 3), (96, 16, 6))  # passes, wheelsets, journeys
ROW = "unknown_position"
MIB = 1024.0  # KiB


def scaling(keep: Path | None) -> Iterator[dict[str, Any]]:
    """Yield one result a size; simulations stay in ``keep`` where it is given."""
    with tempfile.TemporaryDirectory(prefix="treadwatch-scaling-") as folder:
        cache = keep or Path(folder)
        scenario = replace(load_section_scenario(ROW), passes=SIZES[-1][2])
        simulate_section(scenario, 0, cache)
        for size in SIZES:
            with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
                yield pool.submit(measured, size, cache).result()


def measured(size: tuple[int, int, int], cache: Path) -> dict[str, Any]:
    """Return time and peak memory of one size; in a process of its own, else the peak is somebody else's."""
    from bench.section_case import score  # noqa: PLC0415 - so that what loading costs is seen apart

    passes, wheelsets, journeys = size
    whole = replace(load_section_scenario(ROW), passes=SIZES[-1][2])
    run = fewer(simulate_section(whole, 0, cache, workers=1), wheelsets, journeys)
    score(fewer(run, 2, 1))  # compiled from here on
    base = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / MIB
    began = time.process_time()
    found = score(run)
    seconds = time.process_time() - began
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / MIB
    parts = list(found.seconds)
    return {"passes": passes, "parts": parts, "seconds": sum(parts), "all": seconds, "peak_mib": peak, "base_mib": base}


def fewer(run: SectionRun, wheelsets: int, journeys: int) -> SectionRun:
    """Return the run with its first journeys only, and as many wheelsets, spread over the wear."""
    chosen = run.wheelsets[:: len(run.wheelsets) // wheelsets][:wheelsets]
    return replace(run, wheelsets=chosen, scenario=replace(run.scenario, passes=journeys))
