"""Ingests of one vehicle at once: adjacent recordings, two to eight processes, one final state."""

from __future__ import annotations

import random
import shutil
from collections.abc import Iterator
from contextlib import closing
from functools import partial

from api.factory import open_store
from bench.chaos.run import ChaosSettings
from bench.chaos.small_deployment import Databases, databases, fork, ingest, recordings, state, wait_for
from bench.report import BenchRow

SECONDS = 45.0
MOST = 8


def rows(settings: ChaosSettings) -> Iterator[BenchRow]:
    """Yield for each database how many rounds ended in another state than one ingest after the other."""
    rng = random.Random(settings.seed)  # noqa: S311 - drawn rounds, not secrets
    with databases(settings.folder) as both:
        for kind in ("sqlite", "postgresql"):
            rounds = max(settings.size // 2, 1)
            apart, failed = 0, 0
            for number in range(rounds):
                differs, errors = _round(both, kind, rng, 2 + number % (MOST - 1))
                apart, failed = apart + differs, failed + errors
            yield BenchRow(
                f"{rounds} rounds of 2 to {MOST} ingests at once, {kind}: another final state; failed",
                f"{apart}; {failed}",
                "0; 0",
                apart == failed == 0,
            )


def _round(both: Databases, kind: str, rng: random.Random, processes: int) -> tuple[int, int]:
    """Return whether the state differs from that of one ingest after the other, and how many processes failed."""
    folder = both.folder / "recordings"
    cuts = [rng.random() for _ in range(3 * processes - 1)]
    paths = recordings(folder, cuts, SECONDS)
    order = rng.sample(paths, len(paths))
    at_once, alone = both.new(kind), both.new(kind)
    ingest(alone, paths)
    log = both.folder / "ingests.log"
    pids = [fork(partial(ingest, at_once, order[place::processes]), log) for place in range(processes)]
    failed = sum(code != 0 for code in wait_for(pids))
    with closing(open_store(at_once)) as first, closing(open_store(alone)) as second:
        differs = state(first) != state(second)
    both.drop(at_once)
    both.drop(alone)
    shutil.rmtree(folder)
    return int(differs), failed
