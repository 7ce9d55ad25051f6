"""Behind by an hour: chunks over HTTP that nobody decodes, a live bus whose database is away."""

from __future__ import annotations

from collections.abc import Iterator

from bench.chaos import behind_live, behind_uploads
from bench.chaos.part import ChaosSettings
from bench.chaos.small_deployment import databases
from bench.report import BenchRow

VEHICLES = {"postgresql": 4, "sqlite": 2}
SHORT = 1
"""Minutes up to which the run is short: uploads to SQLite alone."""
SHORT_VEHICLES = 12


def rows(settings: ChaosSettings) -> Iterator[BenchRow]:
    """Yield what services do that are behind: refuse or keep, never drop silently, at the same memory.

    Args:
        settings: ``size`` is the length of the backlog in minutes; it is sent faster than it would come.
    """
    with databases(settings.folder) as both:
        if settings.size <= SHORT:
            yield from behind_uploads.rows(both, "sqlite", SHORT_VEHICLES, settings.size)
            return
        for kind, vehicles in VEHICLES.items():
            yield from behind_uploads.rows(both, kind, vehicles, settings.size)
        yield from behind_live.rows(both, settings.folder, settings.size)
