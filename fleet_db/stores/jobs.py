"""Runs of jobs, and what they work on: claims, each under a lease that ends unless it is prolonged."""

from __future__ import annotations

import time
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from sqlalchemy import (
    BigInteger,
    ColumnElement,
    Connection,
    Row,
    Select,
    and_,
    cast,
    delete,
    func,
    insert,
    literal,
    not_,
    or_,
    select,
    text,
    tuple_,
    update,
)

from estimation.errors import AlreadyRunningError, ConflictError, LeaseLostError
from estimation.values.runs import Claimed, JobOutcome, JobRun, JobTrigger
from fleet_db.locks import UnendedLease
from fleet_db.rows import columns_of, equal, given, insert_of, present, table_of, value_of_row
from fleet_db.subjects import Store
from fleet_db.tables.operation import JobRunRow, ResultRow, WorkClaimRow, WorkLeaseRow

LEASES, CLAIMS = table_of(WorkLeaseRow), table_of(WorkClaimRow)
PLACE = "schedule", ("scheduler",)
"""Stage and key of the claim of the one scheduler."""
KEPT_NS = 86_400_000_000_000
"""So long it counts that a worker has ended at a thing."""


class WorkClaimStore(Store):
    """Leases of processes, and what is claimed under them.

    A claim costs the same however much waits: it names what it is for. The clock is that of the database, or of the
    machine with SQLite. Whoever stores results locks the row of the lease first: nobody takes over what is committed.
    """

    def lease(self, holder: str, length_ns: int, owner: int | None = None, unit: str | None = None) -> int:
        """Begin a lease and return its number; those that have ended are removed, what was claimed is free again.

        It ends with that of its owner, the process that runs the job; LeaseLostError: that has ended. A unit of work
        that was begun before was that of a worker that is gone: that lease ends.
        """
        self.end_outdated()
        if owner is not None:
            self.check(owner, holder)
        if unit is not None:
            self.connection.execute(delete(LEASES).where(LEASES.c.unit == unit))
        until = _now(self.connection) + length_ns
        values = {"holder": holder, "owner": owner, "unit": unit, "length_ns": length_ns, "until_ns": until}
        return int(self.connection.execute(insert(LEASES).values(values).returning(LEASES.c.lease_id)).scalar_one())

    def take_place(self, lease: int) -> None:
        """Claim the place of the one scheduler of this database; AlreadyRunningError names who holds it."""
        if not self.take(lease, *PLACE, alone=True).keys:
            held = select(LEASES.c.holder).join(CLAIMS, CLAIMS.c.lease_id == LEASES.c.lease_id)
            raise AlreadyRunningError(self.connection.scalar(held.where(CLAIMS.c.stage == PLACE[0])) or "just ended")

    def take(self, lease: int, stage: str, keys: Sequence[str], *, alone: bool = False) -> Claimed:
        """Claim what is free for a stage; raises IntegrityError where the lease has ended."""
        taken = self._insert(lease, stage, sorted(keys), alone=alone)
        if len(taken) < len(set(keys)) and self.end_outdated():
            taken |= self._insert(lease, stage, sorted(set(keys) - set(taken)), alone=alone)
        ours = tuple(key for key in keys if key in taken)
        rest = set(keys) - set(taken)
        if not rest:
            return Claimed(ours, begun_ns=taken)
        of_others = select(CLAIMS).where(CLAIMS.c.stage == stage, CLAIMS.c.key.in_(rest))
        held = {row.key: row for row in self.connection.execute(of_others)}
        free = tuple((key, held[key].attempts) for key in keys if key in held and held[key].lease_id is None)
        return Claimed(ours, free, len(rest) - len(free), taken)

    def prolong(self, lease: int) -> bool:
        """Let a lease last its length from now; return whether it is still there."""
        until = _now(self.connection) + LEASES.c.length_ns
        prolonged = update(LEASES).where(LEASES.c.lease_id == lease).values(until_ns=until)
        return self.connection.execute(prolonged).rowcount > 0

    def bound(self, length_s: float) -> None:
        """Let the server end this transaction where its process stands still in it for longer than its lease, s."""
        if self.connection.dialect.name == "postgresql":
            name, limit = literal("idle_in_transaction_session_timeout"), literal(str(round(1000 * length_s)))
            self.connection.execute(select(func.set_config(name, limit, literal(True))))  # noqa: FBT003 - of this transaction

    def check(self, lease: int, holder: str) -> None:
        """Raise LeaseLostError unless a lease is still there; nobody ends it before this transaction does."""
        if self.connection.dialect.name == "sqlite":
            there = self.prolong(lease)  # a process that writes without a pause leaves no gap for its other thread
        else:
            there = self.connection.execute(_locked(lease)).first() is not None
        if not there:
            raise LeaseLostError(holder)

    def holds(self, lease: int) -> bool:
        """Return whether a lease is still there."""
        return self.connection.scalar(select(LEASES.c.lease_id).where(LEASES.c.lease_id == lease)) is not None

    def has_holder(self, holder: str) -> bool:
        """Return whether anybody of this name holds a lease."""
        return self.connection.scalar(select(LEASES.c.lease_id).where(LEASES.c.holder == holder)) is not None

    def free(self, lease: int, holder: str, stage: str, keys: Collection[str]) -> None:
        """Forget claims whose work is stored by this transaction; raises LeaseLostError."""
        if self.forget(lease, stage, keys) < len(keys):
            raise LeaseLostError(holder)

    def forget(self, lease: int, stage: str, keys: Collection[str]) -> int:
        """Forget claims that are still under a lease; return how many."""
        claimed = (CLAIMS.c.lease_id == lease, CLAIMS.c.stage == stage, CLAIMS.c.key.in_(sorted(keys)))
        return self.connection.execute(delete(CLAIMS).where(*claimed)).rowcount

    def end(self, lease: int) -> None:
        """End a lease in order, if it is still there: what was claimed under it is forgotten."""
        if self.connection.execute(_locked(lease, ending=True)).first() is None:
            return
        self.connection.execute(delete(CLAIMS).where(CLAIMS.c.lease_id == lease))
        self.connection.execute(delete(LEASES).where(LEASES.c.lease_id == lease))

    def end_late(self, lease: UnendedLease) -> None:
        """End a lease whose process could not reach the database at the end of its work, but lives.

        What it had claimed is free, and it does not count that it had begun, unless others have begun since.
        """
        if lease.alone:
            self.connection.execute(delete(LEASES).where(LEASES.c.lease_id == lease.number))
        begun = tuple_(CLAIMS.c.key, CLAIMS.c.begun_ns).in_(sorted(lease.begun_ns.items()))
        of_nobody = or_(CLAIMS.c.lease_id.is_(None), CLAIMS.c.lease_id == lease.number)
        late = (CLAIMS.c.stage == lease.stage, of_nobody, begun)
        self.connection.execute(delete(CLAIMS).where(*late, CLAIMS.c.attempts == 1))
        self.connection.execute(update(CLAIMS).where(*late).values(attempts=CLAIMS.c.attempts - 1, lease_id=None))

    def forgive(self, holder: str) -> None:
        """End the leases of a worker that was ended for no reason of its work: that does not count against it."""
        of_holder = select(LEASES.c.lease_id).where(LEASES.c.holder == holder)
        self.connection.execute(delete(CLAIMS).where(CLAIMS.c.lease_id.in_(of_holder)))
        self.connection.execute(delete(LEASES).where(LEASES.c.holder == holder))

    def end_outdated(self) -> int:
        """Remove the leases that have ended, with those of the processes that they owned; return how many ended."""
        # one that is being committed under is skipped
        outdated = select(LEASES.c.lease_id).where(_outdated(self.connection)).with_for_update(skip_locked=True)
        ended = self.connection.execute(delete(LEASES).where(LEASES.c.lease_id.in_(outdated))).rowcount
        if ended:
            forgotten = (CLAIMS.c.lease_id.is_(None), CLAIMS.c.begun_ns < _now(self.connection) - KEPT_NS)
            self.connection.execute(delete(CLAIMS).where(*forgotten))
        return ended

    def _insert(self, lease: int, stage: str, keys: Sequence[str], *, alone: bool) -> dict[str, int]:
        """Insert claims, in one order in all transactions; return when each was begun that is ours now."""
        now = _now(self.connection)
        claim = {"stage": stage, "lease_id": lease, "attempts": 1, "begun_ns": now}
        values = [{"key": key, **claim} for key in dict.fromkeys(keys)]
        new = insert_of(self.connection.dialect.name, CLAIMS).values(values)
        forgotten = CLAIMS.c.begun_ns < now - KEPT_NS
        claimed = new.on_conflict_do_update(
            index_elements=[CLAIMS.c.stage, CLAIMS.c.key],
            set_={"lease_id": lease, "attempts": CLAIMS.c.attempts + 1 if alone else literal(1), "begun_ns": now},
            where=CLAIMS.c.lease_id.is_(None) if alone else CLAIMS.c.lease_id.is_(None) & forgotten,
        )
        rows = self.connection.execute(claimed.returning(CLAIMS.c.key, CLAIMS.c.begun_ns))
        return {row.key: row.begun_ns for row in rows}


def living(connection: Connection, leases: Collection[int]) -> frozenset[int]:
    """Return which of these leases last."""
    chosen = select(LEASES.c.lease_id).where(LEASES.c.lease_id.in_(leases), not_(_outdated(connection)))
    return frozenset(connection.scalars(chosen)) if leases else frozenset()


def _outdated(connection: Connection) -> ColumnElement[bool]:
    """Return the condition that a lease has ended by its time.

    One that ends further ahead than its own length was given before the clock was set back: it has ended, too.
    """
    now = _now(connection)
    return or_(LEASES.c.until_ns < now, LEASES.c.until_ns > now + 2 * LEASES.c.length_ns)


def _now(connection: Connection) -> ColumnElement[int]:
    if connection.dialect.name == "sqlite":
        return literal(time.time_ns(), BigInteger)
    return cast(func.extract("epoch", func.clock_timestamp()) * 1_000_000_000, BigInteger)


def _locked(lease: int, *, ending: bool = False) -> Select[tuple[int]]:
    """Return the statement that keeps a lease from being ended by others; unless it is ending it may be prolonged."""
    row = select(LEASES.c.lease_id).where(LEASES.c.lease_id == lease)
    return row.with_for_update() if ending else row.with_for_update(read=True, key_share=True)


RUNS, RESULTS = table_of(JobRunRow), table_of(ResultRow)
RUNNING = JobOutcome.RUNNING.value
# what is returned by an insertion is written without the names of tables
_LEFT_BY_THE_SAME = text(
    "earlier.owner = job_runs.owner AND earlier.outcome = 'running' AND earlier.run_id < job_runs.run_id"
)
GONE = "the process ended during the run"


@dataclass(frozen=True, slots=True)
class JobRunStore:
    """The record of every run."""

    connection: Connection
    owner: int | None = None  # lease of the process that starts runs here

    def start(self, job: str, trigger: JobTrigger, started_ns: int) -> tuple[JobRun, bool]:
        """Record that a run has begun; return it, and whether a result carries a later time than its begin.

        A process runs one job at a time: what it ran before has ended.
        """
        run = JobRun(0, job, trigger, started_ns, None, JobOutcome.RUNNING, {})
        statement = insert(RUNS).values(columns_of(run, "run_id") | {"owner": self.owner})
        newest_ns = select(func.max(RESULTS.c.recorded_ns)).scalar_subquery()
        earlier = select(func.count()).select_from(RUNS.alias("earlier")).where(_LEFT_BY_THE_SAME)
        columns = (RUNS.c.run_id, newest_ns.label("newest_ns"), earlier.scalar_subquery().label("earlier"))
        row = self.connection.execute(statement.returning(*columns)).one()
        if row.earlier:
            self._abandon(started_ns, and_(RUNS.c.owner == self.owner, RUNS.c.run_id != row.run_id))
        return replace(run, run_id=row.run_id), row.newest_ns is not None and row.newest_ns > started_ns

    def finish(
        self, run_id: int, outcome: JobOutcome, counts: Mapping[str, int], finished_ns: int, error: str | None = None
    ) -> JobRun:
        """Record how a run ended and return it.

        Raises:
            NotFoundError: There is none of that number.
            ConflictError: It has ended already, or the lease of its process has.
        """
        owned = or_(RUNS.c.owner.is_(None), RUNS.c.owner.in_(select(LEASES.c.lease_id)))
        row = self.connection.execute(
            update(RUNS)
            .where(RUNS.c.run_id == run_id, RUNS.c.outcome == RUNNING, owned)
            .values(outcome=outcome.value, counts=dict(counts), finished_ns=finished_ns, error=error)
            .returning(RUNS)
        ).first()
        if row is None:
            ended = self.get(run_id)
            reason = f"run {run_id} of {ended.job} has ended: {ended.outcome}"
            raise ConflictError(reason, kind="job run", key=str(run_id))
        return value_of_row(JobRun, row)

    def abandon_running(self, finished_ns: int) -> int:
        """Mark every run as abandoned whose process is gone; return how many."""
        WorkClaimStore(self.connection).end_outdated()
        return self._abandon(finished_ns, or_(RUNS.c.owner.is_(None), RUNS.c.owner.not_in(select(LEASES.c.lease_id))))

    def _abandon(self, finished_ns: int, which: ColumnElement[bool]) -> int:
        abandoned = {"outcome": JobOutcome.ABANDONED.value, "finished_ns": finished_ns, "error": GONE}
        return self.connection.execute(update(RUNS).where(RUNS.c.outcome == RUNNING, which).values(abandoned)).rowcount

    def get(self, run_id: int) -> JobRun:
        """Return one run, abandoned where its process is gone; raises NotFoundError."""
        row = self.connection.execute(select(RUNS).where(RUNS.c.run_id == run_id)).first()
        return self._runs([present(row, "job run", run_id)])[0]

    def page(self, job: str | None, before_id: int | None, limit: int) -> Sequence[JobRun]:
        """Return at most ``limit`` runs with a number below ``before_id``, newest first; as :meth:`get`."""
        statement = select(RUNS).where(*equal(RUNS, job=job), *given(before_id, RUNS.c.run_id.__lt__))
        return self._runs(self.connection.execute(statement.order_by(RUNS.c.run_id.desc()).limit(limit)).all())

    def _runs(self, rows: Sequence[Row[Any]]) -> list[JobRun]:
        owners = {row.owner for row in rows if row.owner is not None and row.outcome == RUNNING}
        gone = owners - living(self.connection, owners)
        runs = [(value_of_row(JobRun, row), row.outcome == RUNNING and row.owner in gone) for row in rows]
        return [replace(run, outcome=JobOutcome.ABANDONED, error=GONE) if is_gone else run for run, is_gone in runs]
