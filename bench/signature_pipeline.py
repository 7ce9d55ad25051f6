"""Signatures through the product: recordings, receiver, geometries that teach, and the job that judges."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

from api.comparison import trial
from api.comparison.study import read_truth
from estimation.jobs import refresh_signatures
from estimation.values.runs import Result
from estimation.values.signatures import ANSWERS, SignatureFinding
from ingest.simulator.drawn_fleet import with_seed
from ingest.simulator.scenario_file import load_scenario

SCENARIOS = Path(__file__).parent / "signature_scenarios"
KINDS = {
    "single": "single wheelsets",
    "vibration": "single wheelsets, axle boxes that vibrate at 10 m/s2 rms",
    "bogies": "soft bogies, axle boxes that vibrate at 2 m/s2 rms",
}


def judged_by_the_product(kind: str, seed: int) -> list[dict[str, Any]]:
    """Return what is said of every wheelset of a fleet by the others, whose conicities are known by their geometries.

    Args:
        kind: Of ``KINDS``.
    """
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
        return {"truth": truth, "reason": "no answer"}
    conicity, apart = record.answer.conicity, record.disagreement
    if conicity.value is None:
        return {"truth": truth, "reason": str(conicity.reason)}
    found: dict[str, Any] = {"truth": truth, "value": conicity.value, "low": conicity.low, "high": conicity.high}
    return found | {"disagrees": apart is not None and apart.disagrees}
