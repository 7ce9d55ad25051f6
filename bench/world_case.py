"""One row of the world bench for one seed: simulate, ingest, jobs; what is published, against the truth."""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass
from pathlib import Path

from api.comparison.trial import record, run_jobs
from bench.deployment import published, received
from bench.wheelset_score import WheelsetScore, wheelset_score
from estimation.storage import Storage
from ingest.simulator.scenario import Scenario


@dataclass(frozen=True, slots=True)
class WorldScore:
    """One row, one seed."""

    row: str
    seed: int
    wheelsets: tuple[WheelsetScore, ...]
    half_widths: tuple[float, ...]  # of the 95 % intervals of conicity that are published
    survey: str  # code of the verdict on the survey; empty without one
    source: str  # of the alignment in force; empty without one
    reason: str  # why there is none
    diversity: float  # of the last epoch; 0 where nothing was solved
    scale_std: float  # of the alignment in force
    seconds: float  # ingest and jobs, wall clock

    def as_json(self) -> dict[str, object]:
        """Return everything as JSON values."""
        return asdict(self)


def score(scenario: Scenario, cache: Path, folder: Path) -> WorldScore:
    """Run a scenario through the product and compare what is published with the truth.

    Args:
        folder: Where the deployment keeps its data; empty.
    """
    recorded = record(scenario, cache, workers=1)
    began = time.perf_counter()
    with received(scenario, recorded, folder) as (storage, context):
        run_jobs(context)
        return stored_score(storage, scenario, recorded.truth, began)


def stored_score(storage: Storage, scenario: Scenario, truth_file: Path, began: float) -> WorldScore:
    """Return what the jobs have stored, compared with the truth.

    Args:
        began: Wall clock (``time.perf_counter``) before the recordings were received, s.
    """
    wheelsets, widths = [], []
    with storage.read() as unit:
        for truth, geometry in published(unit, truth_file):
            wheelsets.append(wheelset_score(geometry, truth))
            intervals = ((one.low, one.high) for one in geometry.conicity)
            widths += [0.5 * (high - low) for low, high in intervals if low is not None and high is not None]
        alignment = unit.tracks.alignment(scenario.section.code)
        report = unit.tracks.report(scenario.section.code)
    found = {} if report is None else report.report
    diversity = found.get("diversity")
    return WorldScore(
        row=scenario.name,
        seed=scenario.seed,
        wheelsets=tuple(wheelsets),
        half_widths=tuple(widths),
        survey=str(found.get("recording_code") or ""),
        source="" if alignment is None else str(alignment.source),
        reason="" if report is None or report.reason is None else str(report.reason),
        diversity=diversity if isinstance(diversity, float) else 0.0,
        scale_std=0.0 if alignment is None else alignment.scale_std,
        seconds=time.perf_counter() - began,
    )
