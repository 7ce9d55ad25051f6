"""The current geometry of a wheelset by any estimator: that of the jobs, or a rival on the same windows."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import lru_cache
from typing import Any

from estimation.errors import PurgedError
from estimation.estimators.catalogue import SHIPPED, estimator_named
from estimation.estimators.interface import Estimator, EstimatorParameters, PublishedBins, geometry_from_motion
from estimation.geometry.estimate import contradictions
from estimation.jobs.job import JobContext
from estimation.jobs.refresh_geometry import geometries_of
from estimation.jobs.steps.estimated_geometry import EstimatedWith
from estimation.jobs.steps.load_window import load_window
from estimation.jobs.steps.rolled_geometries import RolledGeometries
from estimation.jobs.steps.rolling import Part, members
from estimation.motion.integration import WindowParameters
from estimation.motion.window_motion import window_motion
from estimation.storage import Storage, UnitOfWork
from estimation.values.geometry import WheelsetGeometry
from estimation.values.reasons import Reason
from estimation.values.roll_up import Member
from estimation.values.track import Correction, TrackAlignment, TrackLayout
from estimation.values.windows import Motion


def replayed(
    unit: UnitOfWork, members: Sequence[Member], parameters: WindowParameters
) -> Iterator[tuple[Member, Motion]]:
    """Yield each window with its motion, as ``estimate_windows`` tabulated it.

    A window is left out whose position or content has changed since, so that it is refused today, and one whose
    samples have been purged.
    """

    @lru_cache
    def alignment(section: str, version: int | None) -> TrackAlignment | None:
        return unit.tracks.alignment(section, version)

    @lru_cache
    def layout(section: str) -> TrackLayout | None:
        return unit.tracks.layout(section)

    for member in members:
        record, section = member.window.record, member.window.record.track_section
        position = unit.tracks.position(record.wheelset, record.start_ns)
        if position is not None and position.content_digest != record.content_digest:
            position = None  # found from other content
        mounting = unit.registry.mounting_at(record.vehicle, record.axle, record.start_ns)
        try:
            window = load_window(unit, record, parameters.vehicle_class)
        except PurgedError:
            continue
        if isinstance(window, Reason):
            continue
        moved = window_motion(
            window,
            alignment(section, member.window.track_version) if section is not None else None,
            parameters,
            Correction(position.offset_m, position.scale, position.middle_m) if position is not None else None,
            position.reason if position is not None else None,
            mounted_reversed=mounting is not None and mounting.reversed,
            layout=layout(section) if section is not None else None,
        )
        if not isinstance(moved, Reason):
            yield member, moved


def geometry_by(storage: Storage, context: JobContext, serial: str, estimator: str) -> WheelsetGeometry | None:
    """Return the current geometry of a wheelset as an estimator finds it; nothing is stored."""
    with storage.read() as unit:
        found = geometries_of(unit, [serial], context)[serial]
        if estimator != SHIPPED:
            return _by_rival(unit, found, estimator_named(estimator))
        current = [record.geometry for record in found.records() if record.interval is None]
        return current[-1] if current else None


def _by_rival(unit: UnitOfWork, found: RolledGeometries, rival: Estimator[Any]) -> WheelsetGeometry | None:
    """Return the geometry by a rival; what the data say against class and registry holds for it, too."""
    parts = found.current_parts()
    if not parts:
        return None
    used = found.estimated_with(parts)
    published = PublishedBins(used.bins.edges, f"{used.bins.key} {rival.name}")
    parameters = parameters_of(used)
    geometry = geometry_from_motion(rival, parameters, _weighted(unit, found, used, parts), published)
    for contradiction in contradictions(found.forgetting(parts), used.bins, used.uncertainty):
        geometry = geometry.against(contradiction)
    return geometry.against(found.contradiction(parts, (parts[0].roll_up.key.baseline, None)))


def parameters_of(used: EstimatedWith) -> EstimatorParameters:
    """Return what all estimators share, as the job has it."""
    settings = used.settings
    return EstimatorParameters(
        used.assumed.windows.vehicle,
        used.uncertainty,
        settings.geometry.curve,
        settings.signals.source,
        band_limited=True,
    )


def _weighted(
    unit: UnitOfWork, found: RolledGeometries, used: EstimatedWith, parts: Sequence[Part]
) -> Iterator[tuple[float, Motion]]:
    """Yield weight and motion of the windows that have samples, oldest first; the newest has weight 1."""
    together = [member for part in parts for member in members(unit, found.rules, part)]
    ordered = sorted(together, key=lambda member: member.start_ns)
    newest_km = max((part.roll_up for part in parts), key=lambda one: one.last_ns).last_km
    for member, moved in replayed(unit, ordered, used.assumed.windows):
        yield 0.5 ** ((newest_km - member.mileage_km) / found.rules.half_life_km), moved
