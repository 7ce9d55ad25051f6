"""Whether an alert stands: by all data in vehicle time, not by how often they were looked at."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

from estimation.alerts.rules.rule import AlertDelays, WheelsetFacts
from estimation.values.alerts import Finding
from estimation.values.windows import WindowRecord

LOOK_BACK = 5  # times the windows that a rule looks at: what was earlier raises nothing any more


def raised_at(found: Iterable[Finding], delays: AlertDelays) -> int | None:
    """Return when an alert was raised that stands after the findings, ns UTC; None where none stands.

    Parameters
    ----------
    found
        In order of vehicle time; those that decide nothing do not count.
    delays
        Findings on end before it is raised and cleared.
    """
    since_ns: int | None = None
    counted = 0
    for one in found:
        if one.breached is None:
            continue
        towards = one.breached if since_ns is None else bool(one.cleared)
        counted = counted + 1 if towards else 0
        if counted >= (delays.on_evaluations if since_ns is None else delays.off_evaluations):
            since_ns, counted = one.measured_ns if since_ns is None else None, 0
    return since_ns


def latest_run(newest_first: Iterable[Finding], delays: AlertDelays) -> bool:
    """Return whether the latest run of findings that was long enough raised an alert; False where none was.

    That is where an alert ends that is raised by ``on_evaluations`` breaches on end and cleared by ``off_evaluations``
    findings beyond the clear limit. Going back from the newest, most wheelsets are decided by two.

    Parameters
    ----------
    newest_first
        Findings that decide, in falling order of vehicle time; read as far as needed.
    delays
        How many on end raise and clear.
    """
    raising = clearing = 0
    for found in newest_first:
        raising = raising + 1 if found.breached else 0
        clearing = clearing + 1 if found.cleared else 0
        if raising >= delays.on_evaluations:
            return True
        if clearing >= delays.off_evaluations:
            return False
    return False


def began(newest_first: Iterable[Finding], delays: AlertDelays) -> int | None:
    """Return when an alert that stands was raised, ns UTC, looking back to the last run that cleared.

    Parameters
    ----------
    newest_first
        Findings that decide, in falling order of vehicle time; read as far as needed.
    delays
        How many on end raise and clear.
    """
    read: list[Finding] = []
    clearing = 0
    for found in newest_first:
        read.append(found)
        clearing = clearing + 1 if found.cleared else 0
        if clearing >= delays.off_evaluations:
            break
    return raised_at(reversed(read), delays)


def of_windows(
    find: Callable[[Sequence[WindowRecord]], Finding],
    facts: WheelsetFacts,
    suspect: Callable[[WindowRecord], bool],
    latest: int,
    delays: AlertDelays,
) -> Finding:
    """Return the finding of the latest windows, with whether an alert stands had it been evaluated at each of them.

    Parameters
    ----------
    find
        Finding of at most ``latest`` windows, oldest first.
    facts
        Windows in any order; the newest ``LOOK_BACK`` times ``latest`` of them count.
    suspect
        Whether a window can raise anything; without such windows nothing stands.
    latest
        Windows that a finding is made of.
    delays
        Windows before it is raised and cleared.
    """
    now = find(facts.windows)
    if not any(suspect(window) for window in facts.windows):
        return replace(now, stands=False)
    ordered = sorted(facts.windows, key=lambda window: window.start_ns)[-LOOK_BACK * latest :]
    since_ns = raised_at((find(ordered[max(0, end - latest) : end]) for end in range(1, len(ordered) + 1)), delays)
    return replace(now, stands=since_ns is not None, since_ns=since_ns)
