"""Recordings corrected, and what is in quarantine tried again, on the terminal."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import closing

import typer

from api import logs
from api.factory import SystemClock, open_store, raw_store
from api.pipeline import receiver as receiver_of
from api.settings import load_settings
from api.terminal.ingest import changes_line
from api.terminal.recordings import DIGITS, recording_line
from api.terminal.store import columns, user_name
from estimation.errors import TreadwatchError
from estimation.values.runs import SubjectKind
from fleet_db.records import ChunkState, RecordingAction
from fleet_db.stores.estimated_again import STAGE
from ingest.corrections import Author, RecordingCorrections
from ingest.receiver import ChunkReceipt, Receiver


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
            before = unit.chunks.receipt(digest)
        corrections, author = RecordingCorrections(storage, clock), Author(actor or user_name(), why)
        if action is RecordingAction.DELETE:
            record = corrections.delete(before.digest, author, raw_store(settings))
        else:
            record = corrections.correct(
                before.digest, action, author, vehicle, our_clock_was_behind=our_clock_was_behind
            )
        receiver = receiver_of(settings, storage, clock)
        failed = _decode(receiver, (record.digest,) if record.state is ChunkState.STORED else ())
        failed += [error for code in {before.vehicle, record.vehicle} for error in _made_again(receiver, code)]
        with storage.read() as unit:
            typer.echo(columns([recording_line(unit.chunks.receipt(record.digest))]))
    _report(failed)


def retry_and_report(kind: SubjectKind | None, key: str | None) -> None:
    """Try what is in quarantine again: recordings now, the rest at the next run of the jobs; exit 1 where one fails."""
    settings, clock = load_settings(), SystemClock()
    logs.configure(settings)
    with closing(open_store(settings)) as storage:
        with storage.write() as unit:
            items = unit.quarantine.retry(kind, key)
        recordings = [item.key for item in items if item.kind is SubjectKind.RECORDING and item.stage == STAGE]
        failed = _decode(receiver_of(settings, storage, clock), recordings)
    typer.echo(
        f"{len(recordings)} recordings tried now, {len(items) - len(recordings)} others at the next run of their job"
    )
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
