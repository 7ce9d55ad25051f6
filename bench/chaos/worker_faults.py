"""What happens to workers and to those who hand them their work, each at a drawn moment and for a drawn while."""

from __future__ import annotations

import os
import random
import signal
import time
from collections.abc import Callable, Sequence
from contextlib import suppress

from bench.chaos.cuttable_link import Cut
from bench.chaos.worker_services import LEASE_S, Services

Strike = Callable[[Services, random.Random], bool]
"""Does harm and mends it; returns whether there was somebody to be harmed."""
LONGEST_DELAY_S = 0.3
"""Between the moment at which somebody is seen at work, and the harm, s."""


def killed(services: Services, rng: random.Random) -> bool:
    """Kill a worker that is at work."""
    pid = _victim(services, rng)
    if pid is not None:
        _signal([pid], signal.SIGKILL)
    return pid is not None


def stood_still(services: Services, rng: random.Random) -> bool:
    """Stop a worker that is at work for longer than its lease, and wake it."""
    pid = _victim(services, rng)
    if pid is None:
        return False
    _signal([pid], signal.SIGSTOP)
    time.sleep(LEASE_S * rng.uniform(1.2, 2.5))
    _signal([pid], signal.SIGCONT)
    return True


def all_stood_still(services: Services, rng: random.Random) -> bool:
    """Stop the scheduler with all its workers for longer than their leases, as a machine that is suspended."""
    if _victim(services, rng) is None:
        return False
    family = services.family()
    _signal(family, signal.SIGSTOP)
    time.sleep(LEASE_S * rng.uniform(1.2, 2.5))
    _signal(rng.sample(family, len(family)), signal.SIGCONT)
    return True


def refused(services: Services, rng: random.Random) -> bool:
    """Close the connections of a worker to the database and refuse new ones."""
    return _cut_off(services, rng, Cut.CLOSED)


def unreachable(services: Services, rng: random.Random) -> bool:
    """Let nothing through between a worker and the database; what was sent arrives when the link is mended."""
    return _cut_off(services, rng, Cut.SILENT)


def scheduler_killed(services: Services, rng: random.Random) -> bool:
    """Kill the process that hands out the work, and start it again."""
    if _victim(services, rng) is None:
        return False
    services.end_scheduler(signal.SIGKILL)
    time.sleep(rng.uniform(0.0, LEASE_S))
    services.start_scheduler()
    return True


def dask_scheduler_killed(services: Services, rng: random.Random) -> bool:
    """Kill the scheduler of Dask, and start it again."""
    assert services.cluster is not None
    if _victim(services, rng) is None:
        return False
    services.cluster.kill("scheduler")
    time.sleep(rng.uniform(0.0, 2.0 * LEASE_S))
    services.cluster.start_scheduler()
    return True


HERE: Sequence[Strike] = (killed, stood_still, all_stood_still, scheduler_killed)
"""On one machine, whatever the database."""
ON_SERVER: Sequence[Strike] = (*HERE, refused, unreachable)
"""With a database that a worker can be cut off from."""
ON_DASK: Sequence[Strike] = (killed, stood_still, refused, unreachable, scheduler_killed, dask_scheduler_killed)


def _victim(services: Services, rng: random.Random) -> int | None:
    """Return a process that is at work, after a drawn delay; None where nobody works."""
    found = services.at_work()
    if not found:
        return None
    time.sleep(rng.uniform(0.0, LONGEST_DELAY_S))
    return rng.choice(found)


def _cut_off(services: Services, rng: random.Random, how: Cut) -> bool:
    pid = _victim(services, rng)
    if pid is None or services.link is None:
        return False
    had = services.link.cut_off(pid, how)
    time.sleep(rng.uniform(0.5, 3.0 * LEASE_S))
    services.link.restore(pid)
    return had > 0


def _signal(pids: Sequence[int], number: signal.Signals) -> None:
    for pid in pids:
        with suppress(ProcessLookupError):  # it has ended by itself, or was replaced
            os.kill(pid, number)
