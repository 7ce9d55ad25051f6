"""Signatures through the product: recordings, receiver, geometries that teach, and the job that judges."""

from __future__ import annotations

import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from api.comparison import trial
from api.comparison.study import read_truth
from bench.scores import code_of
from bench.signature_cases import SimulatedFleet, entries, tracks, wheelset, window_of, window_parameters
from estimation.jobs import refresh_signatures
from estimation.signatures.answer import judged
from estimation.signatures.library import Libraries, Library, Subject
from estimation.signatures.window_signatures import SignatureParameters, window_signatures
from estimation.values.runs import Result
from estimation.values.signatures import ANSWERS, AxlePosition, LibraryEntry, SignatureFinding
from ingest.simulator.drawn_fleet import with_seed
from ingest.simulator.scenario_file import load_scenario

SCENARIOS = Path(__file__).parent / "signature_scenarios"
KINDS = {
    "single": "single wheelsets",
    "vibration": "single wheelsets, axle boxes that vibrate at 10 m/s2 rms",
    "bogies": "soft bogies, axle boxes that vibrate at 2 m/s2 rms",
}


def judged_by_the_product(kind: str, seed: int) -> list[dict[str, Any]]:
    """Return what is said of every wheelset of a fleet by the others, known by their geometries."""
    scenario = with_seed(load_scenario(SCENARIOS / f"{kind}.toml"), seed)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        recorded = trial.record(scenario, folder / "recordings", workers=1)
        settings = trial.deploy(scenario, folder / "deployment")
        trial.receive(recorded, settings)
        with trial.opened(settings) as (storage, context):
            trial.run_jobs(context)
            refresh_signatures.run(context)
            with storage.read() as unit:
                truth = {one.serial: float(one.conicity[-1]) for one in read_truth(recorded.truth)}
                return [_of(unit.results.latest(ANSWERS, serial), true) for serial, true in sorted(truth.items())]


def _of(result: Result[SignatureFinding] | None, truth: float) -> dict[str, Any]:
    record = None if result is None else result.value
    if record is None:
        return {"truth": truth, "reason": "no answer", "code": "no answer"}
    conicity, apart = record.answer.conicity, record.disagreement
    if conicity.value is None:
        return {"truth": truth, "reason": str(conicity.reason), "code": code_of(conicity)}
    found: dict[str, Any] = {"truth": truth, "value": conicity.value, "low": conicity.low, "high": conicity.high}
    return found | {"disagrees": apart is not None and apart.disagrees}


WHEELSETS, EACH = 200, 20
SECONDS_PER_HOUR = 3600.0


def cost(made: SimulatedFleet) -> dict[str, float]:
    """Return what signatures cost, CPU seconds."""
    shared, apart = judging(made)
    return {"signing": signing(), "shared": shared, "apart": apart}


def signing() -> float:
    """Return the CPU seconds that signatures of an hour of one wheelset take, samples in memory."""
    (track,) = tracks(1, 0).values()
    rng = np.random.default_rng(0)
    window = window_of(wheelset("W", 0.5e-3, 2, rng), "S0", track, 17.0, rng)
    window_signatures(window, window_parameters(), SignatureParameters())  # compiled
    began = time.process_time()
    for _ in range(5):
        window_signatures(window, window_parameters(), SignatureParameters())
    return (time.process_time() - began) / 5 / (1e-9 * window.length_ns) * SECONDS_PER_HOUR


def judging(made: SimulatedFleet) -> tuple[float, float]:
    """Return the CPU seconds of judging 200 wheelsets: with shared libraries, and each with its own (from one)."""
    known, parameters = _large(made), SignatureParameters()
    began = time.process_time()
    libraries = Libraries(known, parameters)
    by_wheelset: dict[str, list[LibraryEntry]] = {}
    for entry in known:
        by_wheelset.setdefault(entry.wheelset, []).append(entry)
    for serial, own in by_wheelset.items():
        subject = Subject(serial, own[0].signature.vehicle_class, AxlePosition.SINGLE)
        libraries.admitted(subject)
        found = libraries.library(subject)
        assert isinstance(found, Library)
        judged(serial, [one.signature for one in own], found, parameters)
    shared = time.process_time() - began
    began = time.process_time()
    Libraries(known, parameters).library(subject)
    return shared, WHEELSETS * (time.process_time() - began)


def _large(made: SimulatedFleet) -> list[LibraryEntry]:
    """Return entries of as many wheelsets: those of the fleet again and again, each copy with other stretches."""
    found: list[LibraryEntry] = []
    own: dict[str, list[LibraryEntry]] = {}
    for entry in entries(made.teaching, np.random.default_rng(0), 0.003):
        own.setdefault(entry.wheelset, []).append(entry)
    serials, rng = sorted(own), np.random.default_rng(1)
    for number in range(WHEELSETS):
        members, name = own[serials[number % len(serials)]], f"C{number}"
        chosen = [members[at] for at in rng.choice(len(members), EACH, replace=False)]
        found += [replace(one, signature=replace(one.signature, wheelset=name)) for one in chosen]
    return found
