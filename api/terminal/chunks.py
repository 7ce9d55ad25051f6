"""Chunks: a drop folder watched, what is received decoded, raw files read again."""

from __future__ import annotations

import logging
import threading
from contextlib import closing, suppress
from dataclasses import replace
from pathlib import Path

import typer

from api import logs
from api.factory import (
    RECEIPT_PATIENCE_S,
    SystemClock,
    backlog_watch,
    open_store,
    process_name,
    publishing,
    raw_store,
    receiver,
)
from api.settings import load_settings
from api.terminal.ingest import vehicle_in_name
from api.terminal.progress import counted
from api.terminal.store import begun, store_once_it_answers
from estimation.errors import InputError, MigrationError, PassingFaultError, StoppedError, StorageError
from estimation.jobs.stop_signals import stop_on_signals
from fleet_db.keeping.checks import ScrubFault, ScrubPlan, scrub
from ingest.intake.backlog import DecodedChunks, decode_received
from ingest.intake.drop_folder import DropFolder, DropSettings, held_folder
from ingest.intake.store import ChunkStorage
from ingest.live.backoff import Backoff

LOOK_EVERY_S = 1.0
FIRST_DELAY_S, LONGEST_DELAY_S = 1.0, 30.0
MEGABYTE = 1_000_000
_log = logging.getLogger(__name__)


def work(*, once: bool) -> None:
    """Decode what is received until a stop is requested."""
    settings, clock = load_settings(), SystemClock()
    stopping = begun(settings)
    opened = store_once_it_answers(settings, stopping)
    if opened is None:
        return

    def checkpoint(done: int, total: int) -> None:
        if stopping.is_set():
            raise StoppedError(done, total)

    with closing(opened) as storage, suppress(StoppedError):
        decoder = receiver(settings, storage, clock)
        while not stopping.is_set():
            done = DecodedChunks()
            try:
                done = decode_received(storage, decoder, process_name(), checkpoint)
            except StorageError as error:
                _log.warning("decoding waits for the database: %s", error)
                if once:
                    raise
            if done.decoded or done.others:
                _log.info("%d chunks decoded, %d could not be", done.decoded, done.others)
            elif once:
                return
            stopping.wait(LOOK_EVERY_S)


def scrub_and_report(mb_per_s: float | None, *, resume: bool) -> None:
    """Read every raw file again, print what is damaged or missing, and exit 1 where anything is."""

    def print_fault(found: ScrubFault) -> None:
        typer.echo(f"recording {found.file.digest[:12]} of vehicle {found.file.vehicle}: {found.fault}")

    settings = load_settings()
    plan = ScrubPlan(None if mb_per_s is None else mb_per_s * MEGABYTE, resume)
    with closing(open_store(settings)) as storage, counted("reading raw files") as progress:
        ended = scrub(storage, raw_store(settings), plan, SystemClock().now_ns, print_fault, progress)
    typer.echo(f"read {ended.files:,} raw files, {ended.file_bytes:,} bytes: {ended.faults:,} damaged or missing")
    if ended.faults:
        raise typer.Exit(1)


def watch(folder: Path, vehicle: str | None, quiet_s: float, *, once: bool) -> None:
    """Watch a folder."""
    settings = load_settings()
    logs.configure(settings)
    if not folder.is_dir():
        raise InputError("is no folder", file=folder)
    stopping = threading.Event()
    stop_on_signals(stopping)
    with held_folder(folder):
        opened = store_once_it_answers(settings, stopping)
        if opened is None:
            return
        with closing(opened) as storage, publishing(settings, lambda: storage) as announce:
            raw = raw_store(settings)
            wanted = DropSettings(
                folder, quiet_s, settings.max_chunk_mb * MEGABYTE, lambda path: vehicle or vehicle_in_name(path)
            )
            chunks = ChunkStorage(replace(storage, patience_s=RECEIPT_PATIENCE_S), raw, SystemClock(), announce)
            _watch(DropFolder(wanted, raw, chunks, backlog_watch(settings, storage, raw)), stopping, once=once)


def _watch(drop: DropFolder, stopping: threading.Event, *, once: bool) -> None:
    delays, waited = Backoff(FIRST_DELAY_S, LONGEST_DELAY_S), ""
    while not stopping.is_set():
        try:
            look = drop.look()
        except MigrationError:
            raise
        except (PassingFaultError, StorageError) as error:
            if str(error) != waited:
                _log.warning("files wait in the folder: %s", error)
            waited = str(error)
            stopping.wait(delays.failed())
            continue
        delays.succeeded()
        behind = "" if look.behind is None else look.behind.limit.value
        if look.behind is not None and behind != waited:
            _log.warning("files wait in the folder: %s", look.behind.text)
        waited = behind
        for line in look.refused:
            _log.warning("refused %s", line)
        if look.stored or look.known:
            _log.info("%d files stored, %d were known already", look.stored, look.known)
        if once and not (look.stored or look.known or look.incomplete):
            return
        stopping.wait(LOOK_EVERY_S)
