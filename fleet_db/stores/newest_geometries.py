"""Which of a wheelset's geometries are the newest of their baseline or interval, however many came before.

A query that groups all versions costs what all versions cost: 70,000 in a year. These step along an index from one
baseline, or interval, to the next one, and take the last version of each.
"""

from __future__ import annotations

from functools import cache

from sqlalchemy import CTE, ColumnElement, ScalarSelect, Select, bindparam, func, literal, select

from fleet_db.rows import table_of
from fleet_db.tables import GeometryRow

GEOMETRIES = table_of(GeometryRow)
VERSIONS = GEOMETRIES.alias("version")
BEFORE_ALL = -(2**31)  # less than the number of any interval


@cache
def newest_of_baselines() -> Select[int]:
    """Return the numbers of the last current geometry of each baseline, of ``serial`` until ``as_of_ns``."""
    baselines = _baselines()
    newest = _newest(VERSIONS.c.baseline == baselines.c.baseline, VERSIONS.c.baseline_interval.is_(None))
    return select(newest.label("geometry_id")).where(baselines.c.baseline.is_not(None))


@cache
def newest_of_intervals() -> Select[int]:
    """Return the numbers of the last geometry of each interval of each baseline, of ``serial`` until ``as_of_ns``."""
    intervals = _intervals(_baselines())
    same = (VERSIONS.c.baseline == intervals.c.baseline, VERSIONS.c.baseline_interval == intervals.c.interval)
    return select(_newest(*same).label("geometry_id")).where(intervals.c.interval > BEFORE_ALL)


def _baselines() -> CTE:
    """Return the baselines with geometries, and a null behind the last one."""
    first, next_ = GEOMETRIES.alias("first_baseline"), GEOMETRIES.alias("next_baseline")
    found = (
        select(func.min(first.c.baseline).label("baseline"))
        .where(first.c.wheelset == bindparam("serial"))
        .cte("baselines", recursive=True)
    )
    behind = (next_.c.wheelset == bindparam("serial"), next_.c.baseline > found.c.baseline)
    step = select(func.min(next_.c.baseline)).where(*behind).correlate(found).scalar_subquery()
    return found.union_all(select(step).where(found.c.baseline.is_not(None)))


def _intervals(baselines: CTE) -> CTE:
    """Return baseline and number of every interval; before the first of a baseline BEFORE_ALL, and a null behind it."""
    next_ = GEOMETRIES.alias("next_interval")
    found = (
        select(baselines.c.baseline, literal(BEFORE_ALL).label("interval"))
        .where(baselines.c.baseline.is_not(None))
        .cte("intervals", recursive=True)
    )
    behind = (
        next_.c.wheelset == bindparam("serial"),
        next_.c.baseline == found.c.baseline,
        next_.c.baseline_interval > found.c.interval,
    )
    step = select(func.min(next_.c.baseline_interval)).where(*behind).correlate(found).scalar_subquery()
    return found.union_all(select(found.c.baseline, step).where(found.c.interval.is_not(None)))


def _newest(*chosen: ColumnElement[bool]) -> ScalarSelect[int]:
    of_wheelset = VERSIONS.c.wheelset == bindparam("serial"), VERSIONS.c.recorded_ns <= bindparam("as_of_ns")
    newest = select(VERSIONS.c.geometry_id).where(*of_wheelset, *chosen)
    return newest.order_by(VERSIONS.c.geometry_id.desc()).limit(1).scalar_subquery()
