"""Decoding what is received, and reading raw files again, on the terminal."""

from __future__ import annotations

import logging
import threading
from contextlib import closing, suppress
from functools import partial

import typer

from api import logs
from api.factory import SystemClock, once_the_database_answers, open_store, process_name, raw_store, receiver
from api.progress import counted
from api.settings import load_settings
from api.tracing import start_tracing
from estimation.errors import StoppedError, StorageError
from estimation.jobs.stop_signals import stop_on_signals
from fleet_db.keeping.scrub import ScrubFault, ScrubPlan, scrub
from fleet_db.stores.raw_scrubs import RawScrub
from ingest.intake.backlog import DecodedChunks, decode_received

LOOK_EVERY_S = 1.0
MEGABYTE = 1_000_000
_log = logging.getLogger(__name__)


def work(*, once: bool) -> None:
    """Decode what is received until a stop is requested."""
    settings = load_settings()
    logs.configure(settings)
    start_tracing()
    stopping, clock = threading.Event(), SystemClock()
    stop_on_signals(stopping)
    opened = once_the_database_answers(partial(open_store, settings), settings, stopping)
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
    """Read every raw file again and print what is damaged or missing.

    Raises:
        typer.Exit: Code 1: something is damaged or missing.
    """
    settings = load_settings()
    plan = ScrubPlan(None if mb_per_s is None else mb_per_s * MEGABYTE, resume)
    with closing(open_store(settings)) as storage, counted("reading raw files") as progress:
        ended = scrub(storage, raw_store(settings), plan, SystemClock().now_ns, _print_fault, progress)
    typer.echo(_summary(ended))
    if ended.faults:
        raise typer.Exit(1)


def _print_fault(found: ScrubFault) -> None:
    typer.echo(f"recording {found.file.digest[:12]} of vehicle {found.file.vehicle}: {found.fault}")


def _summary(ended: RawScrub) -> str:
    return f"read {ended.files:,} raw files, {ended.file_bytes:,} bytes: {ended.faults:,} damaged or missing"
