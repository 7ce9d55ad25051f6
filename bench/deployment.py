"""A deployment of the bench: new, with the recordings of a scenario received, and what it publishes."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from api.comparison.study import TrueWheelset, read_truth
from api.comparison.trial import Recorded, deploy, opened, receive
from estimation.jobs.job import JobContext
from estimation.storage import Storage, UnitOfWork
from estimation.values.geometry import WheelsetGeometry
from ingest.simulator.scenario import Scenario


@contextmanager
def received(scenario: Scenario, recorded: Recorded, folder: Path) -> Iterator[tuple[Storage, JobContext]]:
    """Yield store and jobs of a new deployment that has received the recordings of a scenario.

    Args:
        folder: Where the deployment keeps its data; empty.
    """
    settings = deploy(scenario, folder)
    receive(recorded, settings)
    with opened(settings) as (storage, context):
        yield storage, context


def published(unit: UnitOfWork, truth_file: Path) -> Iterator[tuple[TrueWheelset, WheelsetGeometry]]:
    """Yield every wheelset that has a geometry with samples, the truth first."""
    for truth in read_truth(truth_file):
        current = unit.geometries.current(truth.serial)
        if current is not None and current.geometry.samples.sum() > 0:
            yield truth, current.geometry
