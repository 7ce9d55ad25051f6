"""Windows whose file is lost or damaged are made again from their recordings."""

from __future__ import annotations

from estimation.storage import UnitOfWork
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.windows import WindowRecord

CAUSE = "the file of a window is lost or damaged"


def assemble_if_lost(unit: UnitOfWork, record: WindowRecord, refusal: Reason) -> None:
    """Let the windows of a vehicle at a time be made again where one was refused for its file.

    Args:
        unit: A transaction to write in, that of the refusal.
    """
    if refusal.code is ReasonCode.FILE_DAMAGED:
        unit.stale_spans.add(record.vehicle, record.start_ns, record.start_ns + record.length_ns, CAUSE)
