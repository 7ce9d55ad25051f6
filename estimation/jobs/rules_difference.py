"""How the alerts of two rule books differ: more, fewer, earlier, later. Pure functions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

from estimation.values.alerts import Alert


class Change(StrEnum):
    """What becomes of an alert by other rules."""

    MORE = "more"  # only the other rules raise it
    FEWER = "fewer"  # only the rules in force raise it
    EARLIER = "earlier"  # opened earlier by the other rules
    LATER = "later"
    SHORTER = "shorter"  # opened at the same time, closed earlier
    LONGER = "longer"
    SEVERITY = "severity"  # the same times, another severity
    SAME = "same"


@dataclass(frozen=True, slots=True)
class Difference:
    """One alert by the rules in force and by the other rules; None where these do not raise it."""

    change: Change
    before: Alert | None
    after: Alert | None


def differences(before: Sequence[Alert], after: Sequence[Alert]) -> list[Difference]:
    """Return how the alerts of one wheelset differ; two of a kind that were open at one time are the same alert."""
    left = sorted(before, key=lambda one: one.opened_ns)
    found: list[Difference] = []
    for alert in sorted(after, key=lambda one: one.opened_ns):
        same = next((one for one in left if one.kind == alert.kind and _meet(one, alert)), None)
        if same is None:
            found.append(Difference(Change.MORE, None, alert))
        else:
            left.remove(same)
            found.append(Difference(_change(same, alert), same, alert))
    found += [Difference(Change.FEWER, one, None) for one in left]
    return sorted(found, key=lambda one: min(alert.opened_ns for alert in (one.before, one.after) if alert is not None))


def _meet(one: Alert, other: Alert) -> bool:
    """Return whether two alerts were open at one time."""
    return _ends(one) >= other.opened_ns and _ends(other) >= one.opened_ns


def _ends(alert: Alert) -> float:
    return float("inf") if alert.closed_ns is None else alert.closed_ns


def _change(before: Alert, after: Alert) -> Change:
    if after.opened_ns != before.opened_ns:
        return Change.EARLIER if after.opened_ns < before.opened_ns else Change.LATER
    if _ends(after) != _ends(before):
        return Change.SHORTER if _ends(after) < _ends(before) else Change.LONGER
    return Change.SAME if after.severity is before.severity else Change.SEVERITY
