"""The windows that are ready to be estimated, as the job finds them."""

from __future__ import annotations

from collections.abc import Sequence

from estimation.values.runs import StageInputs, SubjectKind
from estimation.values.windows import DueStage, WindowRecord, WindowState, key_of_text
from fleet_db.storage import SqlUnitOfWork


def waiting_windows(unit: SqlUnitOfWork) -> Sequence[WindowRecord]:
    """Return the windows that wait to be estimated and are ready for it, by wheelset and start."""
    due = unit.due.due(StageInputs(DueStage.TABLES, SubjectKind.WINDOW, (), ""))
    records = unit.windows.several([key_of_text(key) for key in due])
    return [record for record in records if record.state is WindowState.PENDING]
