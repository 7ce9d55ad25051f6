"""Whether rows, files and digests belong together: everything that is stored is read once."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial

from sqlalchemy import Connection, and_, exists, func, select

from estimation.errors import DamagedError
from estimation.values.windows import WindowState
from fleet_db.keeping.kept_files import (
    KeptFile,
    KeptRecording,
    kept_files,
    kept_recordings,
    orphaned_recordings,
    orphaned_samples,
)
from fleet_db.raw import RawStore
from fleet_db.rows import table_of
from fleet_db.storage import SqlStorage, SqlUnitOfWork
from fleet_db.tables.alerts import AlertEventRow, AlertRow
from fleet_db.tables.track import TrackAlignmentRow, WindowPositionRow
from fleet_db.tables.windows import WindowBinTableRow, WindowRow

WINDOWS, TABLES, POSITIONS = table_of(WindowRow), table_of(WindowBinTableRow), table_of(WindowPositionRow)
ALERTS, EVENTS, ALIGNMENTS = table_of(AlertRow), table_of(AlertEventRow), table_of(TrackAlignmentRow)
OF_TABLE = and_(WINDOWS.c.wheelset == TABLES.c.wheelset, WINDOWS.c.start_ns == TABLES.c.start_ns)


@dataclass(frozen=True, slots=True)
class Finding:
    """Something that does not belong together.

    Attributes:
        kind: What was compared: ``recording``, ``window file``, ``rows``, ``packed values``, ``database``, ``orphan``.
    """

    kind: str
    subject: str  # what it is about
    detail: str  # what is wrong
    harmless: bool = False  # whether nothing is lost by it: a file that nothing refers to


@dataclass(frozen=True, slots=True)
class DeepCheck:
    """What a deep check read and found."""

    files: int
    rows: int
    findings: tuple[Finding, ...]

    @property
    def damaged(self) -> bool:
        """Whether anything but orphans was found."""
        return any(not finding.harmless for finding in self.findings)


def check_deep(storage: SqlStorage, raw: RawStore, progress: Callable[[int, int], None]) -> DeepCheck:
    """Read everything that is stored and compare it; changes nothing, and services may run."""
    with storage.read() as unit:
        findings = [*_database(unit.connection), *_rows(unit.connection), *_bins(unit)]
        packed, rows = _packed(unit)
        recordings, files = list(kept_recordings(unit.connection)), list(kept_files(unit.connection))
    findings += packed
    gone: list[tuple[KeptRecording | KeptFile, Finding]] = []
    total = len(recordings) + len(files)
    for done, kept in enumerate(recordings, start=1):
        fault = kept.fault(raw)
        if fault is not None:
            gone.append((kept, Finding("recording", kept.owner, f"{raw.place(kept.digest, kept.suffix)} {fault}")))
        progress(done, total)
    for done, file in enumerate(files, start=len(recordings) + 1):
        fault = file.fault(storage.data_dir)
        if fault is not None:
            gone.append((file, Finding("window file", file.owner, f"{file.path} {fault}")))
        progress(done, total)
    if gone:  # a window that was replaced meanwhile has another file now, and a recording may be purged
        with storage.read() as unit:
            still = {*kept_recordings(unit.connection), *kept_files(unit.connection)}
        findings += [finding for one, finding in gone if one in still]
    left = [
        *(str(path) for path in orphaned_samples(storage)),
        *(one.place for one in orphaned_recordings(storage, raw)),
    ]
    findings += [Finding("orphan", place, "no row refers to it", harmless=True) for place in left]
    return DeepCheck(total, rows, tuple(findings))


def _database(connection: Connection) -> Iterator[Finding]:
    """Yield what the database says of itself."""
    if connection.dialect.name != "sqlite":  # PostgreSQL holds its constraints; pg_amcheck looks at its pages
        return
    for (line,) in connection.exec_driver_sql("PRAGMA integrity_check"):
        if line != "ok":
            yield Finding("database", "integrity_check", str(line))
    for row in connection.exec_driver_sql("PRAGMA foreign_key_check"):
        yield Finding("database", f"{row[0]} row {row[1]}", f"refers to a row of {row[2]} that is not there")


def _rows(connection: Connection) -> Iterator[Finding]:
    """Yield rows that contradict each other."""
    other = select(TABLES.c.wheelset, TABLES.c.start_ns).join(WINDOWS, OF_TABLE)
    for row in connection.execute(other.where(TABLES.c.window_digest != WINDOWS.c.content_digest)):
        yield Finding("rows", f"bin table {row.wheelset}@{row.start_ns}", "is of other samples than its window has")
    for row in connection.execute(other.where(WINDOWS.c.state == WindowState.REFUSED.value)):
        yield Finding("rows", f"bin table {row.wheelset}@{row.start_ns}", "is of a window that was refused")
    without = select(WINDOWS.c.wheelset, WINDOWS.c.start_ns).where(
        WINDOWS.c.state == WindowState.ESTIMATED.value, WINDOWS.c.table_purged_ns.is_(None), ~exists().where(OF_TABLE)
    )
    for row in connection.execute(without):
        yield Finding("rows", f"window {row.wheelset}@{row.start_ns}", "counts as estimated without a bin table")
    yield from _alerts(connection)


def _bins(unit: SqlUnitOfWork) -> Iterator[Finding]:
    """Yield wheelsets whose bins are of another geometry than the current one."""
    for wheelset in unit.registry.wheelsets():
        if not unit.geometries.bins_are_current(wheelset.serial):
            yield Finding("rows", f"bins of wheelset {wheelset.serial}", "are not of its current geometry")


def _alerts(connection: Connection) -> Iterator[Finding]:
    """Yield alerts without an event, or with one of a version that is still to come."""
    last = select(func.max(EVENTS.c.sequence)).group_by(EVENTS.c.alert_id)
    found = select(ALERTS.c.alert_id, ALERTS.c.version, EVENTS.c.alert).outerjoin(
        EVENTS, and_(EVENTS.c.alert_id == ALERTS.c.alert_id, EVENTS.c.sequence.in_(last))
    )
    for row in connection.execute(found):
        if row.alert is None or row.alert["version"] > row.version:
            yield Finding("rows", f"alert {row.alert_id}", "does not belong to its last event")


def _packed(unit: SqlUnitOfWork) -> tuple[list[Finding], int]:
    """Return packed values that cannot be read, and how many values were."""
    findings: list[Finding] = []
    count = 0
    readers = [*_of_wheelsets(unit), *_of_sections(unit)]
    for subject, read in readers:
        try:
            count += read()
        except DamagedError as error:
            findings.append(Finding("packed values", subject, str(error)))
    return findings, count


def _of_wheelsets(unit: SqlUnitOfWork) -> Iterator[tuple[str, Callable[[], int]]]:
    for wheelset in unit.registry.wheelsets():
        serial = wheelset.serial
        yield f"bin tables of {serial}", partial(_tables, unit, serial)
        yield f"geometries of {serial}", partial(_number, partial(unit.geometries.intervals, serial))
        yield f"geometry of {serial}", partial(_one, partial(unit.geometries.current, serial))
        yield f"trend of {serial}", partial(_one, partial(unit.trends.latest, serial))
        yield f"measured profiles of {serial}", partial(_number, partial(unit.registry.measured_profiles, serial))


def _of_sections(unit: SqlUnitOfWork) -> Iterator[tuple[str, Callable[[], int]]]:
    for section, version in unit.connection.execute(select(ALIGNMENTS.c.section, ALIGNMENTS.c.version)):
        yield f"alignment {version} of {section}", partial(_one, partial(unit.tracks.alignment, section, version))
    for record in unit.tracks.sections():
        yield f"layout of {record.code}", partial(_one, partial(unit.tracks.layout, record.code))


def _tables(unit: SqlUnitOfWork, serial: str) -> int:
    return sum(1 for _ in unit.tables.stream(serial, 0, None))


def _number(read: Callable[[], Sequence[object]]) -> int:
    return len(read())


def _one(read: Callable[[], object]) -> int:
    return int(read() is not None)
