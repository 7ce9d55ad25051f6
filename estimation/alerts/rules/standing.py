"""Whether an alert on the latest windows stands: by all of them in vehicle time, not by how often they were seen."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from estimation.alerts.rules.rule import AlertDelays
from estimation.values.alerts import Finding
from estimation.values.windows import WindowRecord

LOOK_BACK = 5  # times the windows that a rule looks at: what was earlier raises nothing any more


def stands(
    find: Callable[[Sequence[WindowRecord]], Finding],
    windows: Sequence[WindowRecord],
    latest: int,
    delays: AlertDelays,
) -> bool:
    """Return whether an alert stands after the windows, had it been evaluated at each of them.

    Parameters
    ----------
    find
        Finding of at most ``latest`` windows, oldest first.
    windows
        In any order; the newest ``LOOK_BACK`` times ``latest`` of them count.
    latest
        Windows that a finding is made of.
    delays
        Evaluations before it is raised and cleared.
    """
    ordered = sorted(windows, key=lambda window: window.start_ns)[-LOOK_BACK * latest :]
    raised, counted = False, 0
    for end in range(1, len(ordered) + 1):
        found = find(ordered[max(0, end - latest) : end])
        if found.breached is None:
            continue
        towards = bool(found.cleared) if raised else found.breached
        counted = counted + 1 if towards else 0
        if counted >= (delays.off_evaluations if raised else delays.on_evaluations):
            raised, counted = not raised, 0
    return raised
