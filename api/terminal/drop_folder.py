"""A drop folder watched until a stop is requested; what happens is logged."""

from __future__ import annotations

import logging
import threading
from contextlib import closing
from dataclasses import replace
from functools import partial
from pathlib import Path

from api import logs
from api.factory import RECEIPT_PATIENCE_S, SystemClock, backlog_watch, once_the_database_answers, open_store, raw_store
from api.settings import Settings, load_settings
from api.terminal.ingest import vehicle_in_name
from api.topic import publishing
from estimation.errors import InputError, MigrationError, PassingFaultError, StorageError
from estimation.jobs.stop_signals import stop_on_signals
from fleet_db.storage import SqlStorage
from ingest.intake.drop_folder import DropFolder, DropSettings, Look, held_folder
from ingest.intake.store import ChunkStorage
from ingest.live.backoff import Backoff
from ingest.receipts import Announce

LOOK_EVERY_S = 1.0
FIRST_DELAY_S, LONGEST_DELAY_S = 1.0, 30.0
MEGABYTE = 1_000_000
_log = logging.getLogger(__name__)


def watch(folder: Path, vehicle: str | None, quiet_s: float, *, once: bool) -> None:
    """Watch a folder."""
    settings = load_settings()
    logs.configure(settings)
    if not folder.is_dir():
        raise InputError("is no folder", file=folder)
    stopping = threading.Event()
    stop_on_signals(stopping)
    with held_folder(folder):
        opened = once_the_database_answers(partial(open_store, settings), settings, stopping)
        if opened is None:
            return
        with closing(opened) as storage, publishing(settings, lambda: storage) as announce:
            _watch(_drop_folder(settings, storage, folder, vehicle, quiet_s, announce), stopping, once=once)


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
        _say(look)
        if once and not (look.stored or look.known or look.incomplete):
            return
        stopping.wait(LOOK_EVERY_S)


def _say(look: Look) -> None:
    for line in look.refused:
        _log.warning("refused %s", line)
    if look.stored or look.known:
        _log.info("%d files stored, %d were known already", look.stored, look.known)


def _drop_folder(
    settings: Settings, storage: SqlStorage, folder: Path, vehicle: str | None, quiet_s: float, announce: Announce
) -> DropFolder:
    def vehicle_of(path: Path) -> str:
        return vehicle or vehicle_in_name(path)

    patient = replace(storage, patience_s=RECEIPT_PATIENCE_S)
    raw = raw_store(settings)
    wanted = DropSettings(folder, quiet_s, settings.max_chunk_mb * MEGABYTE, vehicle_of)
    chunks = ChunkStorage(patient, raw, SystemClock(), announce)
    return DropFolder(wanted, raw, chunks, backlog_watch(settings, storage, raw))
