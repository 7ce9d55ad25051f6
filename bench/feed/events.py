"""What writers commit: alerts that are raised, change and close, each writer those of its own wheelset."""

from __future__ import annotations

import sys
import time
from dataclasses import replace
from pathlib import Path

from api.factory import open_store
from api.settings import Settings
from estimation.values.alerts import Alert, AlertEventKind, CloseReason, Condition, Severity
from estimation.values.registry import FleetRecord, WheelsetRecord
from fleet_db.storage import SqlStorage

FLEET = "bench"
BEGUN_NS = 1_750_000_000_000_000_000
STEPS = (AlertEventKind.RAISED, AlertEventKind.UPDATED, AlertEventKind.ACKNOWLEDGED, AlertEventKind.CLOSED)


def settings_of(folder: Path, database_url: str | None) -> Settings:
    """Return the settings of a deployment of its own."""
    return Settings.model_validate({"data_dir": folder, "database_url": database_url or None, "log_level": "warning"})


def wheelset_of(writer: int) -> str:
    """Return the serial of a writer's wheelset."""
    return f"WS-{writer:04d}"


def populate(storage: SqlStorage, writers: int) -> None:
    """Store a fleet with a wheelset for each writer."""
    with storage.write() as unit:
        unit.registry.add_fleet(FleetRecord(FLEET, "Bench"))
        for writer in range(writers):
            unit.registry.add_wheelset(WheelsetRecord(wheelset_of(writer), FLEET, "P8", 0.46, None, ()))


def new_alert(writer: int) -> Alert:
    """Return an alert that is not stored yet."""
    return Alert(
        alert_id=0,
        fleet=FLEET,
        wheelset=wheelset_of(writer),
        kind="conicity_limit",
        severity=Severity.WARNING,
        condition=Condition.ACTIVE,
        opened_ns=BEGUN_NS,
        last_seen_ns=BEGUN_NS,
        occurrence_count=1,
        probability=0.9,
        evidence={},
        action="reprofile",
        raise_limit=0.4,
        clear_limit=0.38,
    )


def write(storage: SqlStorage, writer: int, steps: int, pause_s: float) -> None:
    """Commit events one by one, and print the note of each with when its commit had ended."""
    alert = new_alert(writer)
    for number in range(steps):
        kind = STEPS[number % len(STEPS)]
        alert = replace(alert, occurrence_count=number + 1)
        if kind is AlertEventKind.CLOSED:
            alert = replace(alert, closed_ns=BEGUN_NS + number, close_reason=CloseReason.REPROFILED)
        note = f"{writer}-{number}"
        with storage.write() as unit:
            alert = unit.alerts.save(alert, [kind], time.time_ns(), note=note)
        print(note, time.time_ns(), flush=True)
        if kind is AlertEventKind.CLOSED:
            alert = new_alert(writer)
        time.sleep(pause_s)


if __name__ == "__main__":
    folder, url, who, how_many, pause = sys.argv[1:]
    opened = open_store(settings_of(Path(folder), url))
    write(opened, int(who), int(how_many), float(pause))
    opened.close()
