"""A storage with one of everything, and all that a database holds."""

from __future__ import annotations

from dataclasses import replace

import sqlalchemy
import stored_values as make

from bench.put_values import put_geometry, put_table
from estimation.values.alerts import AlertEventKind
from estimation.values.runs import JobTrigger
from estimation.values.windows import WindowState
from fleet_db.raw import FileRawStore
from fleet_db.records import ChunkState
from fleet_db.storage import SqlStorage
from fleet_db.tables import Base

RECORDING = b"frames of V-1" * 1000


def fill(storage: SqlStorage) -> None:
    """Store one of everything: a recording, windows with tables, a geometry, a trend, alerts, an alignment."""
    digest = FileRawStore(storage.data_dir / "raw").put_bytes(RECORDING, ".blf")
    with storage.write() as unit:
        record = replace(make.CHUNK, digest=digest, size_bytes=len(RECORDING), state=ChunkState.DECODED,
                         first_ns=make.START, last_ns=make.START + 1, counts={"frames": 3})  # fmt: skip
        unit.chunks.put(record)
        for index in range(3):
            window = make.window(index)
            unit.windows.put(window, 100.0 + index, make.START)
            stored = unit.windows.get("WS-1", window.start_ns)
            assert stored is not None
            put_table(unit, "WS-1", window.start_ns, make.bin_table(index), None, stored.content_digest)
            unit.windows.mark("WS-1", window.start_ns, WindowState.ESTIMATED)
        unit.tracks.add_alignment(make.alignment(3))
        unit.tracks.add_layout(make.layout(1))
        unit.registry.add_measured_profiles(make.measured_profiles(make.START))
        put_geometry(unit, make.geometry_record())
        unit.jobs.start("refresh_geometry", JobTrigger.CLI, 5)
        member = unit.alerts.save(make.ALERT, [AlertEventKind.RAISED], 5)
        fleet = replace(make.ALERT, wheelset=None, kind="limit_forecast")
        raised = unit.alerts.save(fleet, [AlertEventKind.RAISED], 6)
        unit.alerts.save(replace(member, fleet_alert_id=raised.alert_id), [AlertEventKind.UPDATED], 7)


def contents(storage: SqlStorage) -> dict[str, list[tuple[object, ...]]]:
    """Return every row of every table."""
    with storage.engine.connect() as connection:
        return {
            table.name: list(map(tuple, connection.execute(sqlalchemy.select(table).order_by(*table.primary_key))))
            for table in Base.metadata.sorted_tables
        }
