"""One row of the accuracy table for one seed: simulate, ingest, jobs, stored geometries against truth.

Nothing is left out and nothing is set: recordings go through the receiver, windows are examined and screened, passes
become epochs, and the uncertainty of the vehicle parameters is as shipped.

Everything that is counted or measured is returned as plain numbers.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from api.comparison.study import read_truth
from api.comparison.trial import ESTIMATION, record, run_jobs
from bench.deployment import published, received
from bench.section_alignment import AlignmentScore, alignment_score
from bench.wheelset_score import WheelsetScore, wheelset_score
from estimation.storage import Storage
from estimation.values.track import AlignmentSource
from ingest.simulator.scenario import Scenario


@dataclass(frozen=True, slots=True)
class CaseScore:
    """One row, one seed."""

    row: str
    pair: str
    seed: int
    drawn: bool
    wheelsets: tuple[WheelsetScore, ...]
    windows: Mapping[str, int]  # by state
    reasons: Mapping[str, int]  # codes of the windows that were refused
    alignment: AlignmentScore | None  # of the fleet's own
    status: str  # of the alignment; "recorded" where a survey is in force
    reason: str
    seconds: tuple[float, float, float]  # alignment job, windows job, geometry job: processor time
    all_seconds: float  # ingest and jobs, wall clock

    def as_json(self) -> dict[str, object]:
        """Return everything as JSON values."""
        return asdict(self)


def score(scenario: Scenario, cache: Path, folder: Path) -> CaseScore:
    """Run a scenario through the product and compare what is stored with the truth.

    Args:
        folder: Where the deployment keeps its data; empty.
    """
    recorded = record(scenario, cache, workers=1)
    began = time.perf_counter()
    with received(scenario, recorded, folder) as (storage, context):
        clock = [time.process_time()]
        for job in ESTIMATION:
            run_jobs(context, [job])
            clock.append(time.process_time())
        found = _stored(storage, scenario, recorded.truth)
    return CaseScore(
        row=scenario.name,
        pair=scenario.pair,
        seed=scenario.seed,
        drawn=scenario.vehicle_errors is not None,
        wheelsets=found.wheelsets,
        windows=found.windows,
        reasons=found.reasons,
        alignment=found.alignment,
        status=found.status,
        reason=found.reason,
        seconds=(clock[1] - clock[0], clock[2] - clock[1], clock[3] - clock[2]),
        all_seconds=time.perf_counter() - began,
    )


@dataclass(frozen=True, slots=True)
class _Stored:
    """What the store holds after the jobs."""

    wheelsets: tuple[WheelsetScore, ...]
    windows: Mapping[str, int]
    reasons: Mapping[str, int]
    alignment: AlignmentScore | None
    status: str
    reason: str


def _stored(storage: Storage, scenario: Scenario, truth_file: Path) -> _Stored:
    reasons: Counter[str] = Counter()
    with storage.read() as unit:
        for truth in read_truth(truth_file):
            windows = unit.windows.list(truth.serial)
            reasons.update(window.reason.code for window in windows if window.reason is not None)
        wheelsets = [wheelset_score(geometry, truth) for truth, geometry in published(unit, truth_file)]
        section = scenario.section.code
        alignment, report = unit.tracks.alignment(section), unit.tracks.report(section)
        states = {str(state): count for state, count in unit.windows.counts().items()}
    known = alignment is not None and bool(np.isfinite(alignment.alignment).any())
    fleet = known and alignment is not None and alignment.source == AlignmentSource.FLEET
    return _Stored(
        wheelsets=tuple(wheelsets),
        windows=states,
        reasons=dict(reasons),
        alignment=alignment_score(scenario, alignment) if fleet and alignment is not None else None,
        status="estimated" if fleet else "recorded" if known else "unestimated",
        reason="" if known else "no alignment" if report is None else str(report.report.get("reason", "")),
    )
