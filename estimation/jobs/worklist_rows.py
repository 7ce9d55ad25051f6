"""Stage: rows of the worklist. Whoever raises what a row is made from makes it again, in the same transaction.

A run has to make them only where they are of another form than this release's.
"""

from __future__ import annotations

from collections.abc import Mapping

from estimation.jobs.job import JobContext
from estimation.jobs.stage import AnyStage, Counted, Outcome, Stage
from estimation.storage import UnitOfWork
from estimation.values.runs import SubjectKind
from estimation.worklist.row import FACETS, FORM, STAGE


def make_all(unit: UnitOfWork, _: JobContext, __: Mapping[str, tuple[None, Outcome[None]]]) -> Mapping[str, int]:
    """Let all rows be made again at the end of the transaction."""
    unit.worklist.refresh_all()
    return {}


WORKLIST: AnyStage = Stage(
    name=STAGE,
    job="evaluate_alerts",
    kind=SubjectKind.WHEELSET,
    facets=FACETS,
    settings=lambda _: FORM,
    load=lambda *_: {},
    compute=lambda _: Outcome(),
    counted=Counted(looked="looked_at", changed="changed"),
    store=make_all,
    together=True,
    inline=True,
)
