"""What the runner does for every stage: due, cutoff, quarantine, one transaction for results and marks."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from wheelset_life import SetClock, register, run_windows

from estimation.errors import NotFiniteError, StorageError
from estimation.jobs.catalogue import ALL_STAGES
from estimation.jobs.job import JobContext
from estimation.jobs.runner import run
from estimation.jobs.settings import JobSettings
from estimation.jobs.stage import AnyStage, Counted, Outcome, Part, Stage, check_finite
from estimation.storage import UnitOfWork
from estimation.values.geometry import BinStatus, BinValues
from estimation.values.quantities import Estimate, Status
from estimation.values.runs import Facet, Result, ResultKind, SubjectKind
from estimation.values.windows import text_of_key
from fleet_db.due import WINDOWS, list_due
from fleet_db.storage import SqlStorage


@dataclass(frozen=True)
class Length:
    """A value with an uncertainty."""

    length: Estimate


LENGTH = ResultKind("length", SubjectKind.WHEELSET, Length)
SECOND_NS = 10**9


@dataclass
class Facts:
    """What the stage reads, beside the facet that stands for it, and of which subjects it has computed."""

    storage: SqlStorage
    values: dict[str, float | Exception] = field(default_factory=dict)
    computed: list[str] = field(default_factory=list)
    again_ns: int | None = None
    here: bool = False

    def set(self, serial: str, value: float | Exception) -> None:
        self.values[serial] = value
        with self.storage.write() as unit:
            unit.subjects.raised(SubjectKind.WHEELSET, serial, Facet.REGISTRY)

    def load(self, _: UnitOfWork, serials: Sequence[str], __: JobContext) -> Mapping[str, tuple[str, object]]:
        return {serial: (serial, self.values[serial]) for serial in serials if serial in self.values}

    def compute(self, inputs: tuple[str, float | Exception]) -> Outcome[Length]:
        serial, value = inputs
        self.computed.append(serial)
        if isinstance(value, Exception):
            raise value
        return Outcome([Part(Length(Estimate(value, 0.5, None, None, 1.0, Status.ESTIMATED)))], again_ns=self.again_ns)

    def stage(self) -> AnyStage:
        return Stage(
            name="length",
            job="measure",
            kind=SubjectKind.WHEELSET,
            facets=(Facet.REGISTRY,),
            settings=lambda settings: settings.trend,
            load=self.load,
            compute=self.compute,
            counted=Counted("wheelsets", "changed", "unchanged"),
            results=LENGTH,
            here=self.here,
        )


@pytest.fixture
def clock() -> SetClock:
    return SetClock(10**15)


@pytest.fixture(
    params=[("sqlite", False), ("sqlite", True), ("postgres", True)], ids=["claimed", "here", "here-postgres"]
)
def facts(request: pytest.FixtureRequest) -> Facts:
    database, here = request.param
    storage = request.getfixturevalue(f"{database}_storage")
    register(storage, "W1", "W2", "W3")
    facts = Facts(storage, here=here)
    for number, serial in enumerate(("W1", "W2", "W3"), start=1):
        facts.set(serial, float(number))
    return facts


def context(facts: Facts, clock: SetClock, settings: JobSettings | None = None, code: str = "1") -> JobContext:
    return JobContext(facts.storage, clock, code, settings or JobSettings())


def in_force(facts: Facts) -> dict[str, float | None]:
    with facts.storage.read() as unit:
        found: Sequence[Result[Length]] = unit.results.in_force(LENGTH, ["W1", "W2", "W3"])
    return {one.subject: None if one.value is None else one.value.length.value for one in found}


def versions(facts: Facts) -> int:
    """Return how often readers of the results were notified of others."""
    with facts.storage.read() as unit:
        query = "SELECT coalesce(sum(version), 0) FROM subject_versions WHERE facet = 'length'"
        return int(unit.connection.exec_driver_sql(query).scalar_one())


def test_only_what_has_other_inputs_is_computed(facts: Facts, clock: SetClock) -> None:
    first = run(facts.stage(), context(facts, clock))
    assert first == {"wheelsets": 3, "changed": 3, "unchanged": 0, "quarantined": 0}
    assert run(facts.stage(), context(facts, clock)) == {
        "wheelsets": 3, "changed": 0, "unchanged": 3, "quarantined": 0
    }  # fmt: skip
    facts.computed.clear()
    facts.set("W2", 5.0)
    facts.set("W3", 3.0)  # raised, but the same: it is loaded and not computed
    assert run(facts.stage(), context(facts, clock))["changed"] == 1
    assert facts.computed == ["W2"]
    assert in_force(facts) == {"W1": 1.0, "W2": 5.0, "W3": 3.0}
    assert versions(facts) == 4


def test_the_same_value_from_other_inputs_is_no_news(facts: Facts, clock: SetClock) -> None:
    run(facts.stage(), context(facts, clock))
    counts = run(facts.stage(), context(facts, clock, code="2"))
    assert counts["changed"] == 3  # its provenance is another
    assert versions(facts) == 3


def test_other_settings_and_time_make_all_due(facts: Facts, clock: SetClock) -> None:
    facts.again_ns = clock.at_ns + 10 * SECOND_NS
    run(facts.stage(), context(facts, clock))
    facts.computed.clear()
    other = JobSettings(trend=replace(JobSettings().trend, horizon_km=1.0))
    run(facts.stage(), context(facts, clock, other))
    assert facts.computed == []  # this stage reads none of them: the inputs are the same
    clock.at_ns += 10 * SECOND_NS
    run(facts.stage(), context(facts, clock, other))
    assert facts.computed == ["W1", "W2", "W3"]


def test_other_numbers_are_computed_with_from_the_same_inputs(facts: Facts, clock: SetClock) -> None:
    run(facts.stage(), context(facts, clock))
    facts.computed.clear()
    for _ in range(2):
        run(replace(facts.stage(), numbers=(0.5,)), context(facts, clock))
        assert facts.computed == ["W1", "W2", "W3"]


@pytest.mark.parametrize("wrong", [RuntimeError("no"), math.nan, math.inf])
def test_what_fails_keeps_its_result_and_harms_nobody(facts: Facts, clock: SetClock, wrong: float | Exception) -> None:
    run(facts.stage(), context(facts, clock))
    facts.set("W1", 7.0)
    facts.set("W2", wrong)
    counts = run(facts.stage(), context(facts, clock))
    assert (counts["changed"], counts["quarantined"]) == (1, 1)
    assert in_force(facts) == {"W1": 7.0, "W2": 2.0, "W3": 3.0}
    facts.computed.clear()
    assert run(facts.stage(), context(facts, clock))["quarantined"] == 1
    assert facts.computed == []  # it waits
    facts.set("W2", 8.0)
    assert run(facts.stage(), context(facts, clock))["quarantined"] == 0  # other inputs are tried at once
    assert in_force(facts)["W2"] == 8.0
    with facts.storage.read() as unit:
        assert unit.quarantine.held() == []


@pytest.mark.parametrize("wrong", ["value", "std"])
def test_a_bin_that_is_estimated_and_no_number_is_refused_and_one_that_is_not_estimated_may_be_nan(wrong: str) -> None:
    status = (BinStatus.ESTIMATED, BinStatus.TOO_FEW)
    bins = BinValues(np.array([1.0, np.nan]), np.array([0.1, np.nan]), status)
    check_finite(Part((bins,)))
    with pytest.raises(NotFiniteError, match="nan"):
        check_finite(Part((replace(bins, **{wrong: np.array([np.nan, np.nan])}),)))


def test_what_changes_while_it_is_computed_is_due_again(facts: Facts, clock: SetClock) -> None:
    def changing(inputs: tuple[str, float | Exception]) -> Outcome[Length]:
        if inputs == ("W2", 2.0):
            facts.set("W2", 9.0)
        return facts.compute(inputs)

    run(replace(facts.stage(), compute=changing), context(facts, clock))
    assert in_force(facts)["W2"] == 2.0
    run(facts.stage(), context(facts, clock))
    assert in_force(facts)["W2"] == 9.0


def test_a_process_that_dies_between_computing_and_storing_leaves_all_as_it_was(facts: Facts, clock: SetClock) -> None:
    def dies(_: UnitOfWork, __: JobContext, ___: object) -> Mapping[str, int]:
        raise StorageError("gone")

    with pytest.raises(StorageError):
        run(replace(facts.stage(), store=dies), context(facts, clock))
    assert in_force(facts) == {}
    assert run(facts.stage(), context(facts, clock))["changed"] == 3


def test_what_a_stage_raises_of_its_own_inputs_is_seen_where_it_rests(facts: Facts, clock: SetClock) -> None:
    def raises(unit: UnitOfWork, _: JobContext, made: Mapping[str, object]) -> Mapping[str, int]:
        for serial in made:
            unit.subjects.raised(SubjectKind.WHEELSET, serial, Facet.REGISTRY)  # type: ignore[attr-defined]
        return {}

    stage = replace(facts.stage(), store=raises)
    run(stage, context(facts, clock))
    with facts.storage.read() as unit:
        assert unit.marks.due(stage.inputs(context(facts, clock)), clock.at_ns) == {}


def test_a_stage_of_all_subjects_is_due_where_one_of_them_is(facts: Facts, clock: SetClock) -> None:
    def load(_: UnitOfWork, keys: Sequence[str], __: JobContext) -> Mapping[str, tuple[float | Exception, ...]]:
        assert list(keys) == ["all"]
        return {"all": tuple(facts.values.values())}

    def compute(inputs: tuple[float, ...]) -> Outcome[Length]:
        total = Length(Estimate(sum(inputs), 0.5, None, None, 1.0, Status.ESTIMATED))
        return Outcome([Part(total, subject=serial) for serial in facts.values])

    stage = replace(facts.stage(), together=True, load=load, compute=compute)
    assert run(stage, context(facts, clock))["changed"] == 3
    assert in_force(facts) == dict.fromkeys(facts.values, 6.0)
    assert run(stage, context(facts, clock))["changed"] == 0
    facts.set("W1", 2.0)
    assert run(stage, context(facts, clock))["changed"] == 3
    assert in_force(facts) == dict.fromkeys(facts.values, 7.0)


def test_a_stage_of_windows_does_each_until_it_is_another(facts: Facts, clock: SetClock) -> None:
    looked: list[str] = []

    def load(_: UnitOfWork, keys: Sequence[str], __: JobContext) -> Mapping[str, str]:
        return {key: key for key in keys if not key.startswith("W3")}  # of a window that is gone nothing is computed

    def compute(key: str) -> Outcome[Length]:
        looked.append(key)
        if key == keys[0] and len(looked) < 2:
            raise RuntimeError("no")
        return Outcome()

    stage = replace(facts.stage(), kind=SubjectKind.WINDOW, load=load, compute=compute, results=None)
    stage = replace(stage, counted=Counted("windows", "changed"))
    for serial in ("W1", "W2", "W3"):
        run_windows(facts.storage, serial, 1.0, 1)
    with facts.storage.read() as unit:
        keys = [text_of_key(*window.key) for serial in ("W1", "W2") for window in unit.windows.list(serial)]
    assert run(stage, context(facts, clock)) == {"windows": 1, "changed": 0, "quarantined": 1}
    assert looked == keys
    assert run(stage, context(facts, clock))["quarantined"] == 1  # the one that failed waits
    assert looked == keys
    with facts.storage.write() as unit:
        list_due(unit.connection, "length", WINDOWS.c.wheelset == "W1")
    assert run(stage, context(facts, clock))["quarantined"] == 0  # another version is tried at once
    assert run(stage, context(facts, clock)) == {"windows": 0, "changed": 0, "quarantined": 0}
    assert looked == [*keys, keys[0]]
    other = JobSettings(trend=replace(JobSettings().trend, horizon_km=1.0))
    run(stage, context(facts, clock, other))
    assert sorted(looked[3:]) == sorted(keys)


def test_what_another_process_has_stored_meanwhile_is_not_stored_again(facts: Facts, clock: SetClock) -> None:
    """The other one has read what has changed since: what was made of it stays in force."""
    others: list[Mapping[str, int]] = []
    stage = facts.stage()

    def interrupted(inputs: tuple[str, float | Exception]) -> Outcome[Length]:
        if not others:
            others.append({})
            facts.set("W1", 7.0)
            others[0] = run(replace(stage, here=True), context(facts, clock))
        return facts.compute(inputs)

    found = run(replace(stage, here=True, compute=interrupted), context(facts, clock))
    assert in_force(facts) == {"W1": 7.0, "W2": 2.0, "W3": 3.0}
    assert (others[0]["changed"], found["changed"]) == (3, 0)
    assert run(stage, context(facts, clock))["changed"] == 0


def test_a_stage_without_claims_has_marks_that_tell_what_another_process_has_done() -> None:
    unclaimed = [stage for stage in ALL_STAGES if stage.here]
    assert len(unclaimed) >= 5
    assert all(stage.facets and stage.again is None for stage in unclaimed)
