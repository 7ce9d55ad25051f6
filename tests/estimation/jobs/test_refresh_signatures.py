"""Recordings to answers: windows of a simulated fleet, their signatures, and what is said of every wheelset."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from api.comparison import trial
from api.comparison.truth import TrueWheelset, read_truth
from estimation.jobs import refresh_signatures
from estimation.jobs.job import JobContext
from estimation.values.quantities import Status
from estimation.values.reasons import ReasonCode
from estimation.values.registry import Reprofiling
from estimation.values.signatures import Basis
from fleet_db.storage import SqlStorage
from ingest.simulator.scenario_file import load_scenario

SCENARIO = """\
name = "signatures"
description = "12 wheelsets on one surveyed section"
seed = 0

[fleet]
code = "F"
name = "Fleet"

[dynamics]
load = 12263.0

[section]
code = "S"
number = 12
name = "Section"
length_m = 2200.0
alignment_std_mm = 2.0
gauge_std_mm = 0.0
surveyed = true

[speed]
lowest_m_s = 14.0
highest_m_s = 20.0
steady = true

[sensors]
kind = "mems"

[sessions]
start = 2024-03-18T00:00:00Z
campaigns = 1
whole_section = true
first_odometer_km = 100.0
km_between = 100.0

[drawn_fleet]
vehicles = 3
wheelsets_each = 4

[[drawn_fleet.pairs]]
name = "P8/113A"
wheel_profile = "P8"
rail_profile = "56E1"
rail_inclination_1_in = 20.0
deepest_wear_mm = 1.5
"""
Ran = tuple[SqlStorage, JobContext, dict[str, TrueWheelset], dict[str, int]]


@pytest.fixture(scope="module")
def ran(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Ran]:
    """Yield a deployment on which the job has run once, its truth, and what was counted."""
    folder = tmp_path_factory.mktemp("signatures")
    path = folder / "scenario.toml"
    path.write_text(SCENARIO, encoding="utf-8")
    scenario = load_scenario(path)
    recorded = trial.record(scenario, folder / "recordings", workers=1)
    settings = trial.deploy(scenario, folder / "deployment")
    trial.receive(recorded, settings)
    with trial.opened(settings) as (storage, context):
        trial.run_jobs(context)
        counts = dict(refresh_signatures.run(context))
        yield storage, context, {one.serial: one for one in read_truth(recorded.truth)}, counts


def test_wheelsets_are_judged_by_the_others_and_near_the_truth(ran: Ran) -> None:
    storage, _, truth, counts = ran
    assert counts["answered"] == 12
    assert counts["estimated"] >= 8
    errors = []
    with storage.read() as unit:
        for serial, true in truth.items():
            record = unit.signatures.answer(serial)
            assert record is not None
            assert record.left_out["same_wheelset"] > 0
            assert serial not in {one.wheelset for one in record.answer.used}
            if record.answer.conicity.value is not None:
                assert record.answer.basis is Basis.SAME_PLACES
                errors.append(abs(record.answer.conicity.value - true.conicity[-1]))
                assert record.disagreement is not None
            else:
                assert record.answer.conicity.reason is not None
                assert record.answer.states == ()
    assert np.median(errors) < 0.012
    assert max(errors) < 0.04


def test_a_second_run_finds_nothing_to_do(ran: Ran) -> None:
    _, context, _, _ = ran
    counts = refresh_signatures.run(context)
    assert counts["unchanged"] == 12
    assert counts["answered"] == counts["signed"] == counts["without_signature"] == counts["made_again"] == 0


def test_a_wheelset_that_was_turned_has_no_answer_and_teaches_nothing_about_its_old_profile(
    ran: Ran,
) -> None:
    """What was known of the wheelset before is of before: its windows are older than the lathe."""
    storage, context, _, _ = ran
    with storage.write() as unit:
        newest = unit.windows.latest("W05")
        assert newest is not None
        unit.registry.add_reprofiling(Reprofiling("W05", newest.start_ns + 10**12, newest.mileage_km + 5.0))
    counts = refresh_signatures.run(context)
    assert counts["answered"] >= 1
    with storage.read() as unit:
        record = unit.signatures.answer("W05")
    assert record is not None
    assert record.baseline == 1
    assert record.answer.conicity.status is Status.UNESTIMATED
    assert record.answer.conicity.reason is not None
    assert record.answer.conicity.reason.code is ReasonCode.NO_SIGNATURE
    assert record.geometry is None or record.disagreement is None


def test_other_cells_make_all_signatures_again(ran: Ran) -> None:
    _, context, _, first = ran
    wider = replace(context.settings, signatures=replace(context.settings.signatures, cell=300.0))
    counts = refresh_signatures.run(replace(context, settings=wider))
    assert counts["made_again"] == first["signed"] + first["without_signature"]
    assert counts["signed"] > 0
