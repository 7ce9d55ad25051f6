"""The accuracy scenario through the whole chain: frames, recordings, windows, jobs, geometry; against its truth."""

from __future__ import annotations

import json
import tempfile
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from api.factory import SystemClock, open_store, raw_store
from api.pipeline import job_context
from api.settings import Settings
from estimation.jobs.catalogue import run_all
from estimation.values.geometry import WheelsetGeometry
from estimation.values.runs import JobTrigger
from fleet_db.migrate import upgrade
from ingest.catalogue import default_catalogue
from ingest.receiver import Receiver
from ingest.registry_file import load_registry
from ingest.simulator.fleet import run_fleet
from ingest.simulator.scenario_file import load_scenario

SEEDS = (15302, 1, 2)
LOW, HIGH = 1.0, 2.5  # mm of amplitude
STEP = 0.5  # mm: figures in the documents are of these amplitudes, although truth and estimates have finer ones


@dataclass(frozen=True, slots=True)
class ConicityError:
    """Of one wheelset of one seed."""

    name: str
    mean_error: float
    covered: tuple[bool, ...]


def conicity_errors() -> list[ConicityError]:
    """Return the mean absolute error over the amplitudes of every wheelset, seed by seed."""
    return [error for seed in SEEDS for error in _one(seed)]


def _one(seed: int) -> list[ConicityError]:
    with tempfile.TemporaryDirectory(prefix="treadwatch-bench-") as folder:
        scenario = replace(load_scenario("mems"), seed=seed)
        report = run_fleet(scenario, Path(folder) / "recordings")
        settings = Settings(data_dir=Path(folder) / "data", database_url=None)
        upgrade(settings.url)
        with closing(open_store(settings)) as storage:
            with storage.write() as unit:
                load_registry(report.registry, unit, 1)
            receiver = Receiver(
                storage, raw_store(settings), default_catalogue(), SystemClock(), settings.window_length_s
            )
            for recording in report.recordings:
                receiver.receive_file(recording.path, recording.vehicle)
            run_all(job_context(settings, storage), JobTrigger.CLI)
            truths = json.loads(report.truth.read_text(encoding="utf-8"))["wheelsets"]
            with storage.read() as unit:
                found = [(truth, unit.geometries.current(truth["serial"])) for truth in truths]
        return [
            _compare(f"{truth['serial']}/{seed}", truth["campaigns"][0], record.geometry)
            for truth, record in found
            if record is not None
        ]


def is_scored(amplitude: float) -> bool:
    """Return whether an amplitude, mm, is one of those that count."""
    return bool(np.isclose(amplitude / STEP, round(amplitude / STEP)))


def _compare(name: str, truth: dict[str, Any], geometry: WheelsetGeometry) -> ConicityError:
    errors, covered = [], []
    for amplitude, estimate in zip(1e3 * geometry.amplitude, geometry.conicity, strict=True):
        if not is_scored(amplitude):
            continue
        at = np.flatnonzero(np.isclose(truth["amplitude_mm"], amplitude))
        if not (len(at) and estimate.value is not None and estimate.low is not None and estimate.high is not None):
            continue
        true = truth["equivalent_conicity"][int(at[0])]
        covered.append(bool(estimate.low <= true <= estimate.high))
        if LOW <= amplitude <= HIGH:
            errors.append(abs(estimate.value - true))
    return ConicityError(name, float(np.mean(errors)), tuple(covered))
