"""Alerts about track sections: the life cycle of an alert, without a wheelset. Pure functions."""

from __future__ import annotations

from dataclasses import replace

from estimation.alerts.life_cycle import transition
from estimation.alerts.rules.rule import AlertDelays
from estimation.values.alerts import Alert, Finding, Transition


def section_transition(
    open_alert: Alert | None,
    finding: Finding,
    now_ns: int,
    *,
    fleet: str,
    track_section: str,
    delays: AlertDelays,
    rules_version: str,
) -> Transition | None:
    """Return what a finding does to the open alert of a section and kind; None where nothing changes.

    Args:
        open_alert: The open alert of the fleet about the section; None where there is none.
        finding: Of the rule; its wheelset is empty.
    """
    nameless = None if open_alert is None else replace(open_alert, wheelset="")
    found = transition(nameless, finding, now_ns, fleet=fleet, delays=delays, rules_version=rules_version)
    if found is None:
        return None
    return replace(found, alert=replace(found.alert, wheelset=None, track_section=track_section))
