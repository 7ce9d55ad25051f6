"""Geometries as results: their parts are baselines and the mileage intervals of these, their heads what trends read."""

from __future__ import annotations

import math

from estimation.values.geometry import GeometryRecord, WheelsetGeometry, known_conicities, why_no_conicity
from estimation.values.results import Result

MOST_INTERVALS = 999_999
"""To each side of a baseline; the order of the parts as texts is that of the intervals."""


def part_of(baseline: int, interval: int | None) -> str:
    """Return the part of a geometry; without a number of the interval of the current one of the baseline."""
    return f"current.{baseline:04d}" if interval is None else f"{baseline:04d}.{interval + MOST_INTERVALS:07d}"


def key_of_part(part: str) -> tuple[int, int | None]:
    """Return baseline and interval; None is the current geometry."""
    first, _, second = part.partition(".")
    return (int(second), None) if first == "current" else (int(first), int(second) - MOST_INTERVALS)


def result_of_geometry(record: GeometryRecord) -> Result[WheelsetGeometry]:
    """Return a geometry as a result."""
    geometry = record.geometry
    why = why_no_conicity(geometry)
    return Result(
        subject=record.wheelset,
        part=part_of(record.baseline, record.interval),
        made_from=record.input_digest,
        numerics=record.code_version,
        recorded_ns=record.recorded_ns,
        value=geometry,
        status=geometry.status,
        reason=geometry.reason,
        head={
            "mileage_km": None if math.isnan(record.mileage_km) else float(record.mileage_km),
            "from_ns": record.from_ns,
            "to_ns": record.to_ns,
            "windows": geometry.windows,
            "track_versions": {section: list(versions) for section, versions in record.track_versions.items()},
            "conicities": [list(one) for one in known_conicities(geometry)],
            "no_conicity": None if why is None else [why.code.value, why.text],
        },
        parameters=record.parameters,
    )
