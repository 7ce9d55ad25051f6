"""A small registry as a file, and how tests load what they write."""

from __future__ import annotations

import json
from collections.abc import Collection
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from estimation.values.reasons import utc_text
from estimation.values.windows import Window, WindowQuality
from fleet_db.records import Decision
from fleet_db.storage import SqlStorage
from ingest.registry_entry.contents import Entry, RegistryRefusedError, Rule
from ingest.registry_file import load_registry

DAY_NS = 86_400 * 10**9
MOUNTED_NS = 1_704_067_200 * 10**9  # 2024-01-01
NOW_NS = MOUNTED_NS + 400 * DAY_NS


def at(day: int) -> str:
    """Return the time some days after the first mounting."""
    return utc_text(MOUNTED_NS + day * DAY_NS)


FILE: dict[str, Any] = {
    "format": "treadwatch-registry-1",
    "fleets": [{"code": "N", "name": "North"}],
    "vehicles": [
        {
            "code": code,
            "fleet": "N",
            "vehicle_class": "coach",
            "axles": 2,
            "max_speed_km_h": 140.0,
            "axle_offsets_m": [2.0, 4.56],
        }
        for code in ("V-1", "V-2")
    ],
    "wheelsets": [
        {"serial": serial, "fleet": "N", "wheel_profile": "S1002", "nominal_radius_mm": 460.0}
        for serial in ("W-1", "W-2", "W-3")
    ],
    "mountings": [
        {
            "wheelset": "W-1",
            "vehicle": "V-1",
            "axle": 1,
            "from": at(0),
            "vehicle_odometer_km": 50_000.0,
            "wheelset_mileage_km": 50_000.0,
        }
    ],
    "track_sections": [
        {
            "code": "S-1",
            "number": 1,
            "name": "one",
            "rail_profile": "60E1",
            "rail_inclination": 0.05,
            "nominal_gauge_mm": 1435.0,
            "length_m": 1000.0,
        }
    ],
}


def written(folder: Path, content: dict[str, Any]) -> Path:
    """Return a registry file with this content."""
    path = folder / "registry.json"
    path.write_text(json.dumps({"format": FILE["format"]} | content), encoding="utf-8")
    return path


def window(wheelset: str, start_ns: int) -> Window:
    """Return a window of a wheelset on the first axle of V-1, off every section."""
    rows = np.arange(8) * 0.1
    return Window(
        wheelset=wheelset,
        vehicle="V-1",
        axle=1,
        start_ns=start_ns,
        length_ns=30 * 10**9,
        sample_interval_s=0.1,
        lateral_acceleration=rows,
        yaw_acceleration=rows,
        roll_acceleration=rows,
        mass_lateral_acceleration=rows,
        speed=np.full(8, 20.0),
        distance=rows * 20.0,
        valid=np.ones(8, bool),
        resolution=(0.1, 0.1, 0.1, 0.1),
        track_section=None,
        odometer_m=1e6,
        quality=WindowQuality(0.98, 0.1, 1, 0.0, 0.02, 20.0, 20.0, 0.9, sensor_fault=False),
    )


def load(
    storage: SqlStorage,
    path: Path,
    confirmed: Collection[Rule] = (),
    decision: Decision = Decision(recorded_ns=NOW_NS),  # noqa: B008 - frozen
) -> None:
    """Load a file as at ``NOW_NS``."""
    with storage.write() as unit:
        load_registry(path, unit, NOW_NS, Entry(decision, NOW_NS, frozenset(confirmed)))


def refused(storage: SqlStorage, path: Path, confirmed: Collection[Rule] = ()) -> RegistryRefusedError:
    """Return why a file is refused."""
    with pytest.raises(RegistryRefusedError) as caught:
        load(storage, path, confirmed)
    return caught.value
