"""Recordings and quarantine on the terminal."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import closing

import typer

from api import factory, logs
from api.factory import SystemClock, open_store
from api.settings import load_settings
from api.terminal.ingest import changes_line
from api.terminal.store import columns, reading, user_name
from api.times import to_rfc3339
from estimation.errors import TreadwatchError
from estimation.values.runs import Quarantined, SubjectKind
from fleet_db.records import ChunkRecord, ChunkState, RecordingAction, RecordingChange
from fleet_db.stores.chunks import ChosenChunks
from fleet_db.stores.estimated_again import STAGE
from ingest.corrections import Author, RecordingCorrections, receipt_of
from ingest.receiver import ChunkReceipt, Receiver

DIGITS = 12  # of a digest, in lists: enough to name it

MOST_LISTED = 10_000


def recording_list(chosen: ChosenChunks, limit: int) -> str:
    """Return recordings as lines, the newest first."""
    with reading() as unit:
        found = unit.chunks.page(chosen, limit)
    head = ("digest", "kind", "vehicle", "received", "first", "last", "frames", "state", "reason")
    return columns([head, *map(_line, found)])


def recording_text(digest: str) -> str:
    """Return the receipt of a recording and the record of what was done to it."""
    with reading() as unit:
        record = receipt_of(unit, digest)
        changes = unit.recording_changes.list(record.digest)
    code = "" if record.reason is None else record.reason.code
    rows = [
        ("digest", record.digest),
        ("kind", record.suffix),
        ("file name", record.file_name or ""),
        ("bytes", str(record.size_bytes)),
        ("vehicle", record.vehicle),
        ("received", to_rfc3339(record.received_ns)),
        ("clock checked", "" if record.clock_checked_ns is None else to_rfc3339(record.clock_checked_ns)),
        ("span", " ".join(_times(record))),
        ("frames", str(record.frames)),
        ("state", record.state.value),
        ("reason code", code),
        ("reason", "" if record.reason is None else record.reason.text),
        *((name.replace("_", " "), str(count)) for name, count in sorted(record.counts.items())),
    ]
    return "\n".join([columns(rows), *map(_change_line, changes)])


def correct_and_report(
    action: RecordingAction,
    digest: str,
    actor: str,
    why: str,
    vehicle: str | None = None,
    *,
    our_clock_was_behind: bool = False,
) -> None:
    """Correct a recording, decode and assemble what has to be, print how it stands; exit 1 where decoding fails."""
    settings, clock = load_settings(), SystemClock()
    logs.configure(settings)
    with closing(open_store(settings)) as storage:
        with storage.read() as unit:
            before = receipt_of(unit, digest)
        corrections, author = RecordingCorrections(storage, clock), Author(actor or user_name(), why)
        if vehicle is not None:
            record = corrections.reassign(before.digest, vehicle, author)
        elif action is RecordingAction.RETRY:
            record = corrections.retry(before.digest, author, our_clock_was_behind=our_clock_was_behind)
        elif action is RecordingAction.DELETE:
            record = corrections.delete(before.digest, author, factory.raw_store(settings))
        elif action is RecordingAction.SET_ASIDE:
            record = corrections.set_aside(before.digest, author)
        else:
            record = corrections.restore(before.digest, author)
        receiver = factory.receiver(settings, storage, clock)
        failed = _decode(receiver, (record.digest,) if record.state is ChunkState.STORED else ())
        failed += [error for code in {before.vehicle, record.vehicle} for error in _made_again(receiver, code)]
        with storage.read() as unit:
            typer.echo(columns([_line(receipt_of(unit, record.digest))]))
    _report(failed)


def quarantine_list(*, everything: bool) -> str:
    """Return what is in quarantine as lines, by last failure."""
    with reading() as unit:
        found = unit.quarantine.all(MOST_LISTED) if everything else unit.quarantine.held()
    head = ("kind", "key", "stage", "state", "reason code", "attempts", "first", "last", "next", "error")
    return columns([head, *map(_quarantine_line, found)])


def retry_and_report(kind: SubjectKind | None, key: str | None) -> None:
    """Try what is in quarantine again: recordings now, the rest at the next run of the jobs; exit 1 where one fails."""
    settings, clock = load_settings(), SystemClock()
    logs.configure(settings)
    with closing(open_store(settings)) as storage:
        with storage.write() as unit:
            found = unit.quarantine.retry(kind, key)
        own = [item.key for item in found if item.kind is SubjectKind.RECORDING and item.stage == STAGE]
        failed = _decode(factory.receiver(settings, storage, clock), own)
    typer.echo(f"{len(own)} recordings tried now, {len(found) - len(own)} others at the next run of their job")
    _report(failed)


def _decode(receiver: Receiver, digests: Iterable[str]) -> list[str]:
    failed = []
    for digest in digests:
        for outcome in receiver.decode_stored(digest):
            if not isinstance(outcome, ChunkReceipt):
                failed.append(str(outcome))
            elif outcome.record.reason is not None:
                failed.append(f"{digest[:DIGITS]}: {outcome.record.reason}")
    return failed


def _made_again(receiver: Receiver, vehicle: str) -> list[str]:
    for _ in receiver.decode_stored(vehicle=vehicle):
        pass  # recordings whose time one had given them find it elsewhere, or wait
    try:
        changes = receiver.reassembler.work_off(vehicle)
    except TreadwatchError as error:
        return [f"windows of vehicle {vehicle} stay to be made again: {error}"]
    typer.echo(f"vehicle {vehicle}: {changes_line(changes)}")
    return []


def _report(failed: Sequence[str]) -> None:
    for line in failed:
        typer.echo(line, err=True)
    if failed:
        raise typer.Exit(1)


def _line(record: ChunkRecord) -> tuple[str, ...]:
    reason = "" if record.reason is None else f"{record.reason.code}: {record.reason.text}"
    first, last = _times(record)
    received = to_rfc3339(record.received_ns)
    shown = (record.digest[:DIGITS], record.suffix, record.vehicle, received, first, last)
    return (*shown, str(record.frames), record.state.value, reason)


def _times(record: ChunkRecord) -> tuple[str, str]:
    if record.first_ns is None or record.last_ns is None:
        return "-", "-"
    return to_rfc3339(record.first_ns), to_rfc3339(record.last_ns)


def _change_line(change: RecordingChange) -> str:
    vehicles = (
        "" if change.vehicle_before == change.vehicle_after else f" {change.vehicle_before} -> {change.vehicle_after}"
    )
    states = f"{change.state_before} -> {change.state_after}"
    return f"{to_rfc3339(change.recorded_ns)} {change.action}{vehicles} ({states}) by {change.actor}: {change.why}"


def _quarantine_line(item: Quarantined) -> tuple[str, ...]:
    times = (to_rfc3339(item.first_ns), to_rfc3339(item.last_ns), to_rfc3339(item.due_ns))
    return (
        item.kind.value,
        item.key,
        item.stage,
        item.state.value,
        item.code.value,
        str(item.attempts),
        *times,
        item.error,
    )
