"""What is exported loads to the same registry, to the last bit."""

from __future__ import annotations

import json
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from registry_files import FILE, NOW_NS, load, written
from scenario_text import SMALL
from sqlalchemy import delete

from estimation.contact.profiles import wheel_profile
from estimation.errors import InputError
from estimation.values.registry import WheelsetRecord
from fleet_db.records import Decision, RecordKind
from fleet_db.storage import SqlStorage
from fleet_db.stores.registry_history import RecordKey
from fleet_db.tables import Base
from ingest.registry_entry.contents import CONFIRMABLE
from ingest.registry_export import export_registry, write_export
from ingest.simulator.fleet import prepare
from ingest.simulator.scenario_file import read_scenario
from ingest.vehicle_class_schema import shipped_class

KEPT = (
    "fleets", "vehicle_classes", "vehicles", "wheelsets", "mountings", "reprofilings", "measured_profiles",
    "track_sections", "track_alignments", "track_layouts",
)  # fmt: skip


def state(storage: SqlStorage) -> dict[str, list[str]]:
    """Return every row of the registry, without the times at which it was recorded."""
    with storage.engine.connect() as connection:
        rows = {
            name: [row._mapping for row in connection.execute(Base.metadata.tables[name].select())] for name in KEPT
        }
    return {name: sorted(repr({**row, "recorded_ns": 0}) for row in found) for name, found in rows.items()}


def emptied(storage: SqlStorage) -> None:
    with storage.engine.begin() as connection:
        for table in reversed(Base.metadata.sorted_tables):
            if table.name != "feed_branches":
                connection.execute(delete(table))
    storage.kept.of(None)  # behind its back: it counts the versions of the registry from the first one again


def round_trip(storage: SqlStorage, folder: Path) -> None:
    """Export, load into the emptied database, and compare."""
    before = state(storage)
    with storage.read() as unit:
        write_export(folder / "exported.json", unit)
    emptied(storage)
    load(storage, folder / "exported.json", CONFIRMABLE)
    assert state(storage) == before
    with storage.read() as unit:
        again = export_registry(unit, "exported-files")
    assert again.text == (folder / "exported.json").read_text(encoding="utf-8")


def measurement() -> dict[str, Any]:
    sides = {side: {"file": f"{side}.txt"} for side in ("left", "right")}
    return {"wheelset": "A", "at": "2024-12-31T00:00:00Z", "mileage_km": 40_000.1, "std_mm": 0.15} | sides


def test_a_simulated_registry_with_measured_profiles_curves_and_classes(storage: SqlStorage, tmp_path: Path) -> None:
    (tmp_path / "small.toml").write_text(SMALL)
    registry = prepare(read_scenario(tmp_path / "small.toml"), tmp_path / "out")
    y = np.arange(-68.0, 60.0, 0.25)
    for side, worn in (("left", 0.0), ("right", 0.4)):
        z = wheel_profile("P8").height(y * 1e-3) * 1e3 - worn * np.exp(-((y / 20.0) ** 2))
        np.savetxt(registry.parent / f"{side}.txt", np.column_stack([y, z]))
    layout = "s_m,curvature_per_km,cant_mm\n0,0,0\n700.1,0.333,70.7\n900,0.333,70.7\n"
    (registry.parent / "layout.csv").write_text(layout)
    content = json.loads(registry.read_text())
    content["measured_profiles"] = [measurement()]
    content["track_sections"][0] |= {"layout": {"file": "layout.csv"}, "length_m": 1000.3, "nominal_gauge_mm": 1434.9}
    content["track_sections"][0]["tonnage_mgt_per_year"] = 17.3
    registry.write_text(json.dumps(content))
    load(storage, registry, CONFIRMABLE)
    with storage.write() as unit:
        unit.registry.add_vehicle_class(shipped_class("coach"), NOW_NS)
    round_trip(storage, tmp_path)


NAMES = st.text(st.characters(exclude_categories=("Cs", "Cc")), min_size=1, max_size=20).filter(str.strip)
KM = st.floats(0.0, 2000.0)


@settings(
    max_examples=15, database=None, derandomize=True,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)  # fmt: skip
@given(
    names=st.tuples(NAMES, NAMES, NAMES),
    numbers=st.tuples(st.floats(1.0, 600.0), st.floats(140.0, 650.0), st.floats(500.0, 2000.0), KM, KM),
    nanosecond=st.integers(0, 999_999_999),
)
def test_any_registry(
    sqlite_storage: SqlStorage, names: tuple[str, ...], numbers: tuple[float, ...], nanosecond: int
) -> None:
    speed, radius, gauge, odometer, mileage = numbers
    begin = f"2024-01-08T05:30:07.{nanosecond:09d}Z"
    mounting = {"wheelset": "W-1", "vehicle": "V-1", "axle": 1, "from": begin, "reversed": True}
    content = FILE | {
        "fleets": [{"code": "N", "name": names[0]}],
        "vehicles": [one | {"max_speed_km_h": speed, "vehicle_class": "own"} for one in FILE["vehicles"]],
        "wheelsets": [one | {"nominal_radius_mm": radius, "wheel_profile": names[1]} for one in FILE["wheelsets"]],
        "mountings": [mounting | {"vehicle_odometer_km": odometer, "wheelset_mileage_km": mileage}],
        "reprofilings": [{"wheelset": "W-1", "at": begin, "mileage_km": mileage, "note": names[2]}],
        "track_sections": [FILE["track_sections"][0] | {"nominal_gauge_mm": gauge, "rail_inclination": mileage / 4e3}],
    }
    emptied(sqlite_storage)
    with TemporaryDirectory() as folder:
        load(sqlite_storage, written(Path(folder), content), CONFIRMABLE)
        round_trip(sqlite_storage, Path(folder))


def test_what_was_voided_is_not_exported(sqlite_storage: SqlStorage, tmp_path: Path) -> None:
    load(sqlite_storage, written(tmp_path, FILE), CONFIRMABLE)
    with sqlite_storage.write() as unit:
        unit.registry.add_wheelset(WheelsetRecord("W-X", "N", "P8", 0.46, None))
        unit.corrections.void(RecordKey(RecordKind.WHEELSET, "W-X"), Decision("ada", "never was", 1))
    with sqlite_storage.read() as unit:
        serials = [one["serial"] for one in json.loads(export_registry(unit, "f").text)["wheelsets"]]
    assert serials == ["W-1", "W-2", "W-3"]


def test_nothing_is_written_over(sqlite_storage: SqlStorage, tmp_path: Path) -> None:
    (tmp_path / "there.json").write_text("mine")
    (tmp_path / "new-files").mkdir()
    with sqlite_storage.read() as unit:
        for name in ("there.json", "new.json"):
            with pytest.raises(InputError, match="exists; give another name"):
                write_export(tmp_path / name, unit)
    assert (tmp_path / "there.json").read_text() == "mine"
