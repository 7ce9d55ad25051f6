"""Whether rows, files and digests belong together: all of them read once, or raw files at a bounded rate."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import partial

from sqlalchemy import Connection, and_, exists, func, select

from estimation.errors import DamagedError, PassingFaultError
from estimation.values.runs import SubjectKind, after_failure, resolved
from estimation.values.windows import WindowState
from fleet_db.keeping.kept_files import (
    Holdings,
    Kept,
    KeptFile,
    kept_files,
    kept_recordings,
    orphaned_recordings,
    orphaned_samples,
)
from fleet_db.raw import RawStore, check_raw_store
from fleet_db.records import ChunkState, RawScrub
from fleet_db.rows import same_window, table_of
from fleet_db.storage import SqlStorage, SqlUnitOfWork
from fleet_db.stores.chunks import RawFile
from fleet_db.tables.alerts import AlertEventRow, AlertRow
from fleet_db.tables.track import TrackAlignmentRow, WindowPositionRow
from fleet_db.tables.windows import WindowBinTableRow, WindowRow

WINDOWS, TABLES, POSITIONS = table_of(WindowRow), table_of(WindowBinTableRow), table_of(WindowPositionRow)
ALERTS, EVENTS, ALIGNMENTS = table_of(AlertRow), table_of(AlertEventRow), table_of(TrackAlignmentRow)
OF_TABLE = same_window(WINDOWS, TABLES)


@dataclass(frozen=True, slots=True)
class Finding:
    """Something that does not belong together."""

    kind: str  # what was compared: a recording, window file, rows, packed values, the database, an orphan
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
        findings = [*_database(unit.connection), *_rows(unit)]
        packed, rows = _packed(unit)
        recordings, files = list(kept_recordings(unit.connection)), list(kept_files(unit.connection))
    findings += packed
    gone: list[tuple[Kept, Finding]] = []
    here = Holdings(storage.data_dir, raw)
    to_check: list[Kept] = [*recordings, *files]
    for done, kept in enumerate(to_check, start=1):
        fault = kept.fault(here)
        if fault is not None:
            kind = "window file" if isinstance(kept, KeptFile) else "recording"
            gone.append((kept, Finding(kind, kept.owner, f"{kept.at(here)} {fault}")))
        progress(done, len(to_check))
    if gone:  # a window that was replaced meanwhile has another file now, and a recording may be purged
        with storage.read() as unit:
            still = {*kept_recordings(unit.connection), *kept_files(unit.connection)}
        findings += [finding for kept, finding in gone if kept in still]
    orphans = [*map(str, orphaned_samples(storage)), *(file.place for file in orphaned_recordings(storage, raw))]
    findings += [Finding("orphan", place, "no row refers to it", harmless=True) for place in orphans]
    return DeepCheck(len(to_check), rows, tuple(findings))


def _database(connection: Connection) -> Iterator[Finding]:
    if connection.dialect.name != "sqlite":  # PostgreSQL holds its constraints; pg_amcheck looks at its pages
        return
    for (line,) in connection.exec_driver_sql("PRAGMA integrity_check"):
        if line != "ok":
            yield Finding("database", "integrity_check", str(line))
    for row in connection.exec_driver_sql("PRAGMA foreign_key_check"):
        yield Finding("database", f"{row[0]} row {row[1]}", f"refers to a row of {row[2]} that is not there")


def _rows(unit: SqlUnitOfWork) -> Iterator[Finding]:
    connection = unit.connection
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
    last = select(func.max(EVENTS.c.sequence)).group_by(EVENTS.c.alert_id)
    alerts = select(ALERTS.c.alert_id, ALERTS.c.version, EVENTS.c.alert).outerjoin(
        EVENTS, and_(EVENTS.c.alert_id == ALERTS.c.alert_id, EVENTS.c.sequence.in_(last))
    )
    for alert_id, version, alert in connection.execute(alerts):
        if alert is None or alert["version"] > version:
            yield Finding("rows", f"alert {alert_id}", "does not belong to its last event")
    for wheelset in unit.registry.wheelsets():
        if not unit.geometries.bins_are_current(wheelset.serial):
            yield Finding("rows", f"bins of wheelset {wheelset.serial}", "are not of its current geometry")


def _packed(unit: SqlUnitOfWork) -> tuple[list[Finding], int]:
    findings: list[Finding] = []
    count = 0
    for subject, read in _readers(unit):
        try:
            value = read()
            count += sum(1 for _ in value) if isinstance(value, Iterable) else int(value is not None)
        except DamagedError as error:
            findings.append(Finding("packed values", subject, str(error)))
    return findings, count


def _readers(unit: SqlUnitOfWork) -> Iterator[tuple[str, Callable[[], object]]]:
    """Yield what holds packed values, of wheelsets and of sections, and what reads them."""
    for wheelset in unit.registry.wheelsets():
        serial = wheelset.serial
        yield f"bin tables of {serial}", partial(unit.tables.stream, serial, 0, None)
        yield f"geometries of {serial}", partial(unit.geometries.intervals, serial)
        yield f"geometry of {serial}", partial(unit.geometries.current, serial)
        yield f"trend of {serial}", partial(unit.trends.latest, serial)
        yield f"measured profiles of {serial}", partial(unit.registry.measured_profiles, serial)
    for section, version in unit.connection.execute(select(ALIGNMENTS.c.section, ALIGNMENTS.c.version)):
        yield f"alignment {version} of {section}", partial(unit.tracks.alignment, section, version)
    for record in unit.tracks.sections():
        yield f"layout of {record.code}", partial(unit.tracks.layout, record.code)


STAGE = "scrub"
"""Under which damaged and missing files are in quarantine; a later reading that finds one whole ends that."""
FILES_AT_ONCE = 50  # files between two commits of how far it has come


@dataclass(frozen=True, slots=True)
class ScrubPlan:
    """How a scrub goes: bytes a second at most (None: as fast as the disk), and whether an unfinished one goes on."""

    bytes_per_s: float | None = None
    resume: bool = True


@dataclass(frozen=True, slots=True)
class ScrubFault:
    """A raw file that is damaged or missing."""

    file: RawFile
    fault: str


def scrub(
    storage: SqlStorage,
    raw: RawStore,
    plan: ScrubPlan,
    now_ns: Callable[[], int],
    found: Callable[[ScrubFault], None],
    progress: Callable[[int, int], None],
    sleep: Callable[[float], None] = time.sleep,
) -> RawScrub:
    """Read every raw file, mark what is damaged or missing in quarantine, and return how it ended; services may run.

    ``progress`` may raise to end the work, and the next scrub goes on from there. PassingFaultError: not mounted.
    """
    check_raw_store(storage, raw, now_ns())
    with storage.write() as unit:
        last = unit.raw_scrubs.last()
        going = last is not None and last.finished_ns is None and plan.resume
        now = last if last is not None and going else unit.raw_scrubs.begin(now_ns())
        total = now.files + unit.raw_scrubs.count_after(now.after_digest)
    began_s, read = time.monotonic(), 0
    while True:
        with storage.read() as unit:
            files = unit.raw_scrubs.files_after(now.after_digest, FILES_AT_ONCE)
        for file in files:
            fault = raw.fault(file.digest, file.suffix)
            marked = _mark(storage, file, fault, now_ns())
            if marked is not None:
                found(marked)
            read += file.size_bytes
            now = replace(
                now,
                after_digest=file.digest,
                files=now.files + 1,
                file_bytes=now.file_bytes + file.size_bytes,
                faults=now.faults + (marked is not None),
            )
            if plan.bytes_per_s is not None:
                sleep(max(0.0, read / plan.bytes_per_s - (time.monotonic() - began_s)))
            progress(now.files, max(total, now.files))
        ended = len(files) < FILES_AT_ONCE
        now = replace(now, finished_ns=now_ns() if ended else None)
        with storage.write() as unit:
            unit.raw_scrubs.put(now)
        if ended:
            return now


def _mark(storage: SqlStorage, file: RawFile, fault: PassingFaultError | None, now_ns: int) -> ScrubFault | None:
    """Keep in quarantine that a file is damaged, or that it no longer is; return the fault unless it is none by now."""
    subject = (SubjectKind.RECORDING, file.digest, STAGE)
    with storage.read() as unit:
        before = unit.quarantine.get(*subject)
    if fault is None:
        if before is not None and before != resolved(before):
            with storage.write() as unit:
                unit.quarantine.put(resolved(before))
        return None
    with storage.write() as unit:
        record = unit.chunks.get(file.digest)
        if record is None or record.purged_ns is not None or record.state is ChunkState.DELETED:
            return None  # its file was deleted meanwhile, as it was to be
        unit.quarantine.put(after_failure(before, subject, file.vehicle, fault, now_ns))
    return ScrubFault(file, fault.reason)
