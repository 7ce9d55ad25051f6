"""One row of the vehicle bench for one seed: what is published of each wheelset, why not, and what it cost."""

from __future__ import annotations

import time
from collections import Counter
from dataclasses import asdict, dataclass
from pathlib import Path

from api.comparison.study import read_truth
from api.comparison.trial import record, run_jobs
from bench.deployment import received
from bench.world_case import WorldScore, stored_score
from estimation.storage import Storage, UnitOfWork
from estimation.values.quantities import Status
from estimation.values.reasons import Reason
from ingest.simulator.scenario import Scenario

SECONDS_PER_HOUR = 3600.0


@dataclass(frozen=True, slots=True)
class Verdict:
    """What the product says of one wheelset."""

    serial: str
    status: str  # of the geometry; ``unestimated`` without one
    code: str  # of the reason beside it, else of most of its refused windows; empty where there is none
    published: bool  # whether any conicity is


@dataclass(frozen=True, slots=True)
class VehicleScore:
    """One row, one seed."""

    found: WorldScore
    verdicts: tuple[Verdict, ...]
    cpu_seconds: float  # of the jobs
    wheelset_hours: float  # recorded

    def as_json(self) -> dict[str, object]:
        """Return everything as JSON values, without nesting of the score."""
        values = asdict(self)
        return values.pop("found") | values


def score(scenario: Scenario, cache: Path, folder: Path) -> VehicleScore:
    """Run a scenario through the product and compare what is published with the truth.

    Args:
        folder: Where the deployment keeps its data; empty.
    """
    recorded = record(scenario, cache, workers=1)
    began = time.perf_counter()
    with received(scenario, recorded, folder) as (storage, context):
        cpu_began = time.process_time()
        run_jobs(context)
        cpu = time.process_time() - cpu_began
        found = stored_score(storage, scenario, recorded.truth, began)
        verdicts = _verdicts(storage, recorded.truth)
    sessions = scenario.sessions
    hours = len(verdicts) * sessions.campaigns * sessions.duration / SECONDS_PER_HOUR
    return VehicleScore(found, verdicts, cpu, hours)


def _verdicts(storage: Storage, truth_file: Path) -> tuple[Verdict, ...]:
    with storage.read() as unit:
        return tuple(_verdict(unit, truth.serial) for truth in read_truth(truth_file))


def _verdict(unit: UnitOfWork, serial: str) -> Verdict:
    current = unit.geometries.current(serial)
    if current is None:
        return Verdict(serial, str(Status.UNESTIMATED), _window_code(unit, serial), published=False)
    geometry = current.geometry
    published = any(one.value is not None for one in geometry.conicity)
    reason: Reason | None = geometry.reason
    if reason is None and not published:
        reason = geometry.equivalent_conicity.reason
    code = "" if reason is None else reason.code
    return Verdict(
        serial, str(geometry.status), code or (_window_code(unit, serial) if not published else ""), published
    )


def _window_code(unit: UnitOfWork, serial: str) -> str:
    """Return the code for which most windows of a wheelset were refused; empty where none was."""
    codes = Counter(window.reason.code for window in unit.windows.list(serial) if window.reason is not None)
    return codes.most_common(1)[0][0] if codes else ""
