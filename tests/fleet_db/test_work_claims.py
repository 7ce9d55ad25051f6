"""Claims on work: who may work on what, until when, and what a worker that lost its claim can still do; on both."""

from __future__ import annotations

import threading
import time
from concurrent.futures import ThreadPoolExecutor

import pytest
from sqlalchemy import select, text, update

from estimation.errors import LeaseLostError
from estimation.values.registry import FleetRecord
from estimation.values.runs import JobTrigger
from fleet_db.rows import table_of
from fleet_db.storage import SqlStorage
from fleet_db.stores.jobs import KEPT_NS
from fleet_db.tables.operation import WorkClaimRow, WorkLeaseRow

CLAIMS, LEASES = table_of(WorkClaimRow), table_of(WorkLeaseRow)
LONG_S, SHORT_S = 600.0, 0.4


def test_what_is_claimed_is_nobody_elses_and_forgotten_at_the_end(storage: SqlStorage) -> None:
    with storage.leased("a", ["1", "2"], "first", LONG_S) as (_, first):
        with storage.leased("a", ["2", "3"], "second", LONG_S) as (_, second):
            assert (first.keys, first.elsewhere) == (("1", "2"), 0)
            assert (second.keys, second.elsewhere) == (("3",), 1)
        with storage.leased("b", ["1"], "third", LONG_S) as (_, third):
            assert third.keys == ("1",)  # of another stage
    with storage.leased("a", ["2"], "fourth", LONG_S) as (_, again):
        assert again.keys == ("2",)
    assert rows(storage) == (0, 0)


def test_an_exception_ends_a_claim_in_order(storage: SqlStorage) -> None:
    with pytest.raises(ValueError, match="of the work"), storage.leased("a", ["1"], "one", LONG_S):
        raise ValueError("of the work")
    assert rows(storage) == (0, 0)


def test_a_lease_lasts_as_long_as_its_process_prolongs_it(storage: SqlStorage) -> None:
    with storage.leased("a", ["1"], "one", SHORT_S) as (_, claimed):
        time.sleep(3 * SHORT_S)
        with storage.leased("a", ["1"], "two", LONG_S) as (_, other):
            assert (claimed.keys, other.elsewhere) == (("1",), 1)


def test_what_a_worker_ended_at_is_taken_alone_and_counted(storage: SqlStorage) -> None:
    for ended in range(3):
        gone(storage, "1", alone=ended > 0)
        with storage.leased("a", ["1", "2"], "next", LONG_S) as (_, claimed):
            assert (claimed.keys, claimed.ended) == (("2",), (("1", ended + 1),))
    with storage.leased("a", ["1"], "next", LONG_S, alone=True) as (_, claimed):
        assert claimed.keys == ("1",)
    with storage.leased("a", ["1"], "next", LONG_S) as (_, claimed):
        assert (claimed.keys, claimed.ended) == (("1",), ())  # it ended in order


def test_that_a_worker_ended_at_a_thing_counts_for_a_day(storage: SqlStorage) -> None:
    gone(storage, "1")
    for aged_ns, ended in ((KEPT_NS - 60 * 10**9, (("1", 1),)), (60 * 10**9, ())):
        with storage.write() as unit:
            unit.connection.execute(update(CLAIMS).values(begun_ns=CLAIMS.c.begun_ns - aged_ns))
        with storage.leased("a", ["1"], "next", LONG_S) as (_, claimed):
            assert claimed.ended == ended


def test_a_worker_without_its_lease_stores_nothing(storage: SqlStorage) -> None:
    with storage.leased("a", ["1"], "one", LONG_S) as (leased, _):
        end_all(storage)
        assert leased.lease_lost()
        with pytest.raises(LeaseLostError, match="one has lost its lease"), leased.write() as unit:
            unit.registry.add_fleet(FleetRecord("F", "Fleet"))
        with storage.leased("a", ["1"], "two", LONG_S, alone=True) as (other, claimed):
            assert claimed.keys == ("1",)
            with other.write() as unit:
                assert unit.registry.fleets() == []
    assert rows(storage) == (0, 0)


def test_a_lease_from_before_the_clock_was_set_back_has_ended(storage: SqlStorage) -> None:
    with storage.write() as unit:
        unit.work_claims.take(unit.work_claims.lease("one", 10**9), "a", ["1"])
        unit.connection.execute(update(LEASES).values(until_ns=LEASES.c.until_ns + 400 * 86_400 * 10**9))
    with storage.leased("a", ["1"], "two", LONG_S) as (_, claimed):
        assert claimed.ended == (("1", 1),)


def test_the_leases_of_a_process_end_with_its_own(storage: SqlStorage) -> None:
    with storage.owned(JobTrigger.CLI, "alive", LONG_S) as alive, alive.leased("a", ["1"], "alive", LONG_S):
        with storage.write() as unit:
            dead = unit.work_claims.lease("dead", 10**15)
            unit.work_claims.take(unit.work_claims.lease("its worker", 10**15, dead), "a", ["2"])
            unit.connection.execute(update(LEASES).where(LEASES.c.lease_id == dead).values(until_ns=0))
        with storage.leased("a", ["1", "2"], "other", LONG_S) as (_, claimed):
            assert (claimed.elsewhere, claimed.ended) == (1, (("2", 1),))
        with pytest.raises(LeaseLostError), storage.write() as unit:
            unit.work_claims.lease("its next worker", 1, dead)
    assert rows(storage) == (1, 0)


def test_of_many_workers_each_thing_is_one_workers(storage: SqlStorage) -> None:
    keys = [str(number) for number in range(40)]
    taken: list[str] = []
    begin = threading.Barrier(4)

    def work(name: int) -> None:
        begin.wait()
        for first in range(0, 40, 8):
            with storage.leased("a", keys[first : first + 12], f"worker {name}", LONG_S) as (_, claimed):
                taken.extend(claimed.keys)
                begin.wait()  # all of them have asked before one ends

    with ThreadPoolExecutor(4) as pool:
        list(pool.map(work, range(4)))
    assert len(taken) == 4 * 12 + 8  # every round has its own twelve keys, once each
    assert rows(storage) == (0, 0)


def test_the_cost_of_a_claim_does_not_grow_with_what_waits(storage: SqlStorage) -> None:
    with storage.write() as unit:
        lease = unit.work_claims.lease("before", 10**15)
        unit.work_claims.take(lease, "a", [f"{number:06}" for number in range(2000)])
    for statement in (
        "SELECT key FROM work_claims WHERE stage = 'a' AND key IN ('000100', '000200')",
        "DELETE FROM work_claims WHERE lease_id = 7",
        "DELETE FROM work_leases WHERE until_ns < 5",
    ):
        assert "index" in plan(storage, statement).lower(), statement


def plan(storage: SqlStorage, statement: str) -> str:
    """Return how the database would execute a statement."""
    on_sqlite = storage.engine.dialect.name == "sqlite"
    with storage.write() as unit:
        if not on_sqlite:
            unit.connection.execute(text("SET LOCAL enable_seqscan = off"))  # few rows: it would scan them
        found = unit.connection.execute(text(f"EXPLAIN {'QUERY PLAN' if on_sqlite else ''} {statement}"))
        return "\n".join(str(row[-1]) for row in found)


def gone(storage: SqlStorage, key: str, *, alone: bool = False) -> None:
    """Claim something and end without a word."""
    with storage.write() as unit:
        taken = unit.work_claims.take(unit.work_claims.lease("gone", 10**15), "a", [key], alone=alone)
        assert taken.keys == (key,)
    end_all(storage)


def end_all(storage: SqlStorage) -> None:
    """Let the time of all leases be over."""
    with storage.write() as unit:
        unit.connection.execute(update(LEASES).values(until_ns=0))
        unit.work_claims.end(unit.work_claims.lease("looks", 1))


def rows(storage: SqlStorage) -> tuple[int, int]:
    """Return how many claims and leases there are."""
    with storage.read() as unit:
        claims, leases = (unit.connection.execute(select(table)).all() for table in (CLAIMS, LEASES))
    return len(claims), len(leases)
