"""Identity changes: when a wheelset on file stopped being the one that ran, or the way round that it ran.

They are found by the alert rule of this kind and kept in the evidence of its alerts. Geometries and trends read them:
data from both sides of a change are of two wheelsets and are never merged.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Protocol, TypeVar

from estimation.values.alerts import Alert

IDENTITY = "identity"  # kind of the alerts that record a change
UNREGISTERED_CHANGE = "unregistered_change"  # kind of the alerts of steps of a trend
BEFORE, AFTER = "before_ns", "after_ns"  # in their evidence


class _Dated(Protocol):
    @property
    def from_ns(self) -> int: ...


_Record = TypeVar("_Record", bound=_Dated)


@dataclass(frozen=True, slots=True)
class IdentityChange:
    """The time within which the wheelset changed; what was recorded within it is of neither."""

    before_ns: int  # end of the data before
    after_ns: int  # begin of the data after


def latest_identity_change(alerts: Iterable[Alert]) -> IdentityChange | None:
    """Return the last change; None where there is none.

    Args:
        alerts: Of one wheelset, open and closed; those of other kinds are left out.
    """
    changes = [_change(alert) for alert in alerts if alert.kind == IDENTITY]
    return max((change for change in changes if change is not None), key=lambda change: change.after_ns, default=None)


def since_change(records: Sequence[_Record], change: IdentityChange | None) -> list[_Record]:
    """Return the geometries of the wheelset that it is now.

    Args:
        records: Geometries of one wheelset, or what is left of them.
        change: Its last; None keeps all records.
    """
    return [record for record in records if change is None or record.from_ns >= change.after_ns]


def _change(alert: Alert) -> IdentityChange | None:
    before, after = alert.evidence.get(BEFORE), alert.evidence.get(AFTER)
    return IdentityChange(before, after) if isinstance(before, int) and isinstance(after, int) else None


def on_one_side(change: IdentityChange | None, first_ns: int, second_ns: int) -> bool:
    """Return whether two times are of the same wheelset: both before its identity change, or both after it.

    Args:
        change: The last one; None where there was none.
        first_ns, second_ns: Times, ns UTC.
    """
    if change is None:
        return True
    before = first_ns <= change.before_ns and second_ns <= change.before_ns
    return before or (first_ns >= change.after_ns and second_ns >= change.after_ns)
