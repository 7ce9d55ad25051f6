"""What failed by itself and is kept apart."""

from __future__ import annotations

import re

from pydantic import Field

from api.schemas.common import Links, Representation
from api.schemas.registry import segment
from api.times import Timestamp, to_rfc3339
from estimation.values.quarantine import Quarantined, QuarantineState, SubjectKind
from estimation.values.reasons import ReasonCode

_FOLDERS = re.compile(r"(?<![\w:/.])/(?:[^\s/:'\"]+/)+")
_RESOURCES = {
    SubjectKind.WHEELSET: "wheelsets",
    SubjectKind.SECTION: "track-sections",
    SubjectKind.VEHICLE: "vehicles",
    SubjectKind.FLEET: "fleets",
}


class QuarantinedItem(Representation):
    """One thing at which one stage of the work failed, and when it is tried again; kept when it succeeds later."""

    kind: SubjectKind
    key: str = Field(description="Digest, serial or code; of a window `serial@start in ns`.", examples=["WS-0001"])
    stage: str = Field(description="The job, or `ingest` for recordings.", examples=["refresh_geometry"])
    state: QuarantineState
    reason_code: ReasonCode
    reason: str = Field(description="First line of the error.")
    attempts: int = Field(description="Failures in a row.")
    first_failed_at: Timestamp
    last_failed_at: Timestamp
    next_attempt_at: Timestamp | None = Field(description="Null once it has succeeded.")
    links: Links


def without_folders(message: str) -> str:
    """Return a message without the folders of the machine."""
    return _FOLDERS.sub("", message)


def quarantined(item: Quarantined) -> QuarantinedItem:
    """Return the representation of what is kept of a failure; its message without the folders of the machine."""
    resource = _RESOURCES.get(item.kind)
    return QuarantinedItem(
        kind=item.kind,
        key=item.key,
        stage=item.stage,
        state=item.state,
        reason_code=item.code,
        reason=without_folders(item.error),
        attempts=item.attempts,
        first_failed_at=to_rfc3339(item.first_ns),
        last_failed_at=to_rfc3339(item.last_ns),
        next_attempt_at=to_rfc3339(item.due_ns) if item.state is QuarantineState.HELD else None,
        links={} if resource is None else {item.kind.value: f"/v1/{resource}/{segment(item.key)}"},
    )
