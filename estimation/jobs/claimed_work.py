"""A unit of work under claims: what is free is done together, what workers have ended at is done one by one."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace

from estimation.errors import LeaseLostError, StorageError, WorkersEndedError
from estimation.jobs.job import JobContext, Work, WorkUnit
from estimation.storage import Storage
from estimation.values.runs import MOST_ENDED

ELSEWHERE, LOST, SET_ASIDE = "worked_on_elsewhere", "leases_lost", "set_aside"


def claimed_work(context: JobContext, stage: Work, unit: WorkUnit) -> Counter[str]:
    """Do the keys of a unit that nobody else works on; return what was counted.

    Raises:
        StorageError: The database, or all of the files, cannot be used; what was committed stays.
    """
    counts, ended = _leased(context, stage, unit)
    for key, times in ended:
        counts += _leased(context, stage, replace(unit, keys=(key,)), ended=times)[0]
    return counts


def _leased(
    context: JobContext, stage: Work, unit: WorkUnit, ended: int = 0
) -> tuple[Counter[str], Sequence[tuple[str, int]]]:
    """Return what was counted, and the keys that are to be done alone with how many workers have ended at each."""
    counts: Counter[str] = Counter()
    terms = (unit.stage, unit.keys, context.holder, context.lease_s)
    with context.storage.leased(*terms, alone=ended > 0, unit=unit.number, owner=unit.owner) as (leased, claimed):
        if claimed.elsewhere:
            counts[ELSEWHERE] += claimed.elsewhere
        if claimed.keys:
            counts.update(_done(replace(context, storage=leased), leased, stage, claimed.keys, ended))
    return counts, claimed.ended


def _done(context: JobContext, leased: Storage, stage: Work, keys: Sequence[str], ended: int) -> Mapping[str, int]:
    try:
        if ended < MOST_ENDED:
            return stage.work(context, keys)
        stage.set_aside(context, keys[0], WorkersEndedError(ended))
    except LeaseLostError:
        return {LOST: 1}
    except StorageError:
        if leased.lease_lost():  # the server has ended a transaction that stood still
            return {LOST: 1}
        raise
    return {SET_ASIDE: 1, "quarantined": 1}
