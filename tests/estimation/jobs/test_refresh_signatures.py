"""Recordings to answers: windows of a simulated fleet, their signatures, and what is said of every wheelset."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from sqlalchemy import update

from api.comparison import trial
from api.comparison.study import TrueWheelset, read_truth
from api.settings import Settings
from estimation.errors import DamagedError
from estimation.jobs import refresh_signatures
from estimation.jobs.job import JobContext
from estimation.signatures.parameters import SIGNATURE
from estimation.values.quantities import Status
from estimation.values.reasons import ReasonCode
from estimation.values.registry import Reprofiling
from estimation.values.runs import EVERYTHING, Facet, SubjectKind
from estimation.values.signatures import ANSWERS, SIGNATURES, Basis, Signature, SignatureFinding, WindowSignatures
from estimation.values.trend import IdentityChange
from fleet_db.migrate import upgrade
from fleet_db.rows import table_of
from fleet_db.storage import SqlStorage
from fleet_db.stores.geometries import GeometryStore
from fleet_db.stores.registry import RegistryStore
from fleet_db.stores.signatures import SignatureStore
from fleet_db.tables.windows import WearSignatureRow, WindowRow
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
            result = unit.results.latest(ANSWERS, serial)
            assert result is not None
            assert result.value is not None
            record = result.value
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


def test_intervals_hold_the_truth_though_geometries_share_their_errors(ran: Ran) -> None:
    storage, _, truth, _ = ran
    held = []
    for serial, true in truth.items():
        conicity = answer(storage, serial).answer.conicity
        if conicity.low is not None and conicity.high is not None:
            held.append(conicity.low <= true.conicity[-1] <= conicity.high)
    assert len(held) >= 8
    assert np.mean(held) >= 0.9


def test_a_second_run_reads_counters_alone(ran: Ran, monkeypatch: pytest.MonkeyPatch) -> None:
    _, context, _, _ = ran
    for method in ("known", "made_of", "vehicles"):
        monkeypatch.setattr(SignatureStore, method, None)
    counts = refresh_signatures.run(context)
    assert counts["unchanged"] == 12
    assert counts["answered"] == counts["signed"] == counts["without_signature"] == counts["made_again"] == 0


def test_a_wheelset_to_which_something_happened_is_looked_at_and_found_unchanged(ran: Ran) -> None:
    storage, context, _, _ = ran
    with storage.write() as unit:
        unit.subjects.raised(SubjectKind.WHEELSET, "W03", SIGNATURES)
    counts = refresh_signatures.run(context)
    assert counts["answered"] == 0
    assert counts["unchanged"] == 12


def test_with_another_number_all_answers_are_made_again(ran: Ran, monkeypatch: pytest.MonkeyPatch) -> None:
    storage, context, _, _ = ran
    with storage.read() as unit:
        library = refresh_signatures.load_library(unit, [EVERYTHING], context)[EVERYTHING]
    assert refresh_signatures.judge(library).parts == []
    monkeypatch.setattr(
        refresh_signatures, "NUMBERS", (replace(SIGNATURE, conicity_step=2.0 * SIGNATURE.conicity_step),)
    )
    assert len(refresh_signatures.judge(library).parts) == 12


def answer(storage: SqlStorage, serial: str) -> SignatureFinding:
    with storage.read() as unit:
        found = unit.results.latest(ANSWERS, serial)
    assert found is not None
    assert found.value is not None
    return found.value


@contextmanager
def stored_otherwise(
    ran: Ran, change: Callable[[Signature], Signature], wheelsets: Collection[str]
) -> Iterator[Mapping[str, int]]:
    """Yield what a run counts after the signatures of some wheelsets were stored otherwise; it is undone at the end."""
    storage, context, _, _ = ran
    with storage.read() as unit:
        before = [one.found for one in unit.signatures.known().known if one.found.wheelset in wheelsets]
    after = [replace(one, signatures=tuple(change(item) for item in one.signatures)) for one in before]

    def put(found: Sequence[WindowSignatures]) -> Mapping[str, int]:
        with storage.write() as unit:
            unit.signatures.put_all(found)
        return refresh_signatures.run(context)

    try:
        yield put(after)
    finally:
        put(before)


def test_entries_of_another_class_teach_nothing_and_its_wheelsets_have_no_library(ran: Ran) -> None:
    with stored_otherwise(ran, lambda one: replace(one, vehicle_class="another"), {"W02"}):
        record = answer(ran[0], "W07")
        assert record.left_out["other_vehicle_class"] > 0
        assert "W02" not in {one.wheelset for one in record.answer.used}
        alone = answer(ran[0], "W02").answer.conicity
    assert alone.value is None
    assert alone.reason is not None
    assert alone.reason.code is ReasonCode.LIBRARY_TOO_SMALL


def test_entries_of_track_that_was_tamped_since_are_retired(ran: Ran) -> None:
    """The two vehicles that ran first saw another track on two stretches than the last one."""
    earlier = {f"W{number:02d}" for number in range(12) if number % 3 != 2}  # the third vehicle ran last

    def of_old_track(one: Signature) -> Signature:
        worked_on = one.place is not None and one.place.cell in {3, 4}
        factor = np.exp(np.linspace(-2.0, 2.0, len(one.spectra)))[:, None]
        return replace(one, spectra=factor * one.spectra) if worked_on else one

    with stored_otherwise(ran, of_old_track, earlier) as counts:
        assert counts["retired"] > 0, counts
        record = answer(ran[0], "W11")
        assert record.left_out["section_changed"] == counts["retired"]
        assert record.signatures > 0
        old = answer(ran[0], "W00")
        assert old.signatures < answer(ran[0], "W11").signatures, "its own stretches of the old track do not count"
    assert "section_changed" not in answer(ran[0], "W11").left_out


def test_signatures_that_are_no_finite_numbers_count_nowhere(ran: Ran) -> None:
    with stored_otherwise(ran, lambda one: replace(one, spectra=np.full_like(one.spectra, np.nan)), {"W04"}):
        silent = answer(ran[0], "W04")
        others = [answer(ran[0], serial) for serial in ("W05", "W06")]
    assert silent.answer.conicity.value is None
    assert silent.answer.conicity.reason is not None
    assert silent.answer.conicity.reason.code is ReasonCode.NO_SIGNATURE
    assert all(one.left_out["not_finite"] > 0 for one in others)
    assert any(one.answer.conicity.value is not None for one in others)


@pytest.mark.parametrize(
    ("change", "code"),
    [
        ({"least_wheelsets": 13}, ReasonCode.LIBRARY_TOO_SMALL),
        ({"least_spread": 1.0}, ReasonCode.LIBRARY_ALIKE),
        ({"most_std": 1e-9}, ReasonCode.LIBRARY_TOO_SMALL),
    ],
    ids=["too few wheelsets", "all alike", "nothing is known well enough"],
)
def test_a_library_that_teaches_nothing_says_why(ran: Ran, change: dict[str, float], code: ReasonCode) -> None:
    storage, context, _, _ = ran
    settings = replace(context.settings, signatures=replace(context.settings.signatures, **change))
    counts = refresh_signatures.run(replace(context, settings=settings))
    assert counts["estimated"] == 0
    for serial in ("W00", "W11"):
        record = answer(storage, serial)
        assert record.answer.conicity.reason is not None
        assert record.answer.conicity.reason.code is code
        assert record.answer.states == ()
        assert record.disagreement is None
    refresh_signatures.run(context)


def test_signatures_whose_samples_are_purged_stay_and_are_left_out_where_they_would_be_made_otherwise(ran: Ran) -> None:
    storage, context, _, _ = ran
    windows = table_of(WindowRow)
    of_one = windows.c.wheelset == "W09"
    with storage.write() as unit:
        unit.connection.execute(update(windows).where(of_one).values(samples_purged_ns=1))
        unit.subjects.raised(SubjectKind.WHEELSET, "W09", SIGNATURES)
    refresh_signatures.run(context)
    assert answer(storage, "W09").signatures > 0
    wider = replace(context.settings, signatures=replace(context.settings.signatures, cell=250.0))
    counts = refresh_signatures.run(replace(context, settings=wider))
    assert counts["made_again"] > 0
    assert answer(storage, "W08").left_out["samples_purged"] > 0
    assert "W09" not in {one.wheelset for one in answer(storage, "W08").answer.used}
    with storage.write() as unit:
        unit.connection.execute(update(windows).where(of_one).values(samples_purged_ns=None))
        unit.subjects.raised(SubjectKind.WHEELSET, "W09", SIGNATURES)
    refresh_signatures.run(context)


def held(storage: SqlStorage) -> dict[tuple[str, str], ReasonCode]:
    with storage.read() as unit:
        return {(str(item.kind), item.key): item.code for item in unit.quarantine.held(refresh_signatures.JOB.name)}


def test_a_damaged_signature_is_kept_in_quarantine_made_again_and_stops_nobody(ran: Ran) -> None:
    storage, context, _, _ = ran
    table = table_of(WearSignatureRow)
    with storage.write() as unit:
        one = next(one.found for one in unit.signatures.known().known if one.found.wheelset == "W03")
        own = (table.c.wheelset == "W03", table.c.start_ns == one.start_ns)
        unit.connection.execute(update(table).where(*own).values(packed=b"torn"))
        unit.subjects.raised(SubjectKind.WHEELSET, "W03", SIGNATURES)
    counts = refresh_signatures.run(context)
    assert counts["quarantined"] == 1
    assert held(storage) == {("window", f"W03@{one.start_ns}"): ReasonCode.FILE_DAMAGED}
    assert answer(storage, "W07").answer.conicity.value is not None
    assert refresh_signatures.run(context)["signed"] == 1, "its samples are there"
    assert held(storage) == {}
    with storage.read() as unit:
        assert one.start_ns in {again.found.start_ns for again in unit.signatures.known().known}


@pytest.mark.parametrize("damaged", ["measured_profiles", "current"])
def test_what_is_damaged_of_a_wheelset_stops_no_other(ran: Ran, monkeypatch: pytest.MonkeyPatch, damaged: str) -> None:
    storage, context, _, _ = ran
    store: Any = RegistryStore if damaged == "measured_profiles" else GeometryStore
    read = getattr(store, damaged)

    def torn(self: object, wheelset: str) -> object:
        if wheelset == "W06":
            raise DamagedError(f"{damaged} of W06: torn")
        return read(self, wheelset)

    with monkeypatch.context() as patched:
        patched.setattr(store, damaged, torn)
        with storage.write() as unit:
            unit.subjects.raised(SubjectKind.WHEELSET, "W06", SIGNATURES)
        assert refresh_signatures.run(context)["quarantined"] == 1
        assert held(storage) == {("wheelset", "W06"): ReasonCode.FILE_DAMAGED}
        if damaged == "measured_profiles":
            assert answer(storage, "W07").left_out["file_damaged"] > 0
    assert refresh_signatures.run(context)["quarantined"] == 0
    assert held(storage) == {}


def test_an_empty_database_has_nothing_to_do(tmp_path: Path) -> None:
    settings = Settings(data_dir=tmp_path, database_url=None, raw_store=None, _env_file=None)  # type: ignore[call-arg] # of pydantic-settings
    upgrade(settings.url)
    with trial.opened(settings) as (_, context):
        counts = refresh_signatures.run(context)
    assert set(counts.values()) == {0}


def test_signatures_of_before_an_identity_change_say_nothing_of_the_wheelset_that_it_is_now(
    ran: Ran, monkeypatch: pytest.MonkeyPatch
) -> None:
    storage, context, truth, _ = ran
    serial, later = min(truth), IdentityChange(10**18, 2 * 10**18)  # behind all windows
    with monkeypatch.context() as exchanged:
        exchanged.setattr(refresh_signatures, "with_identity_alerts", lambda *_: frozenset({serial}))
        exchanged.setattr(refresh_signatures, "identity_change", lambda *_: later)
        with storage.write() as unit:
            unit.subjects.raised(SubjectKind.WHEELSET, serial, Facet.RESTARTS)
        refresh_signatures.run(context)
        found = answer(storage, serial).answer.conicity
    assert found.reason is not None
    assert found.reason.code is ReasonCode.NO_SIGNATURE
    with storage.write() as unit:
        unit.subjects.raised(SubjectKind.WHEELSET, serial, Facet.RESTARTS)
    refresh_signatures.run(context)
    assert answer(storage, serial).answer.conicity.reason != found.reason


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
    record = answer(storage, "W05")
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
