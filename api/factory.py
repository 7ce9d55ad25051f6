"""The composition root of what stores: settings become a database, raw recordings and a clock."""

from __future__ import annotations

import logging
import os
import socket
import time
from collections.abc import Callable
from pathlib import Path
from threading import Event
from typing import TypeVar
from urllib.parse import unquote, urlsplit

from api.settings import PREFIX, Settings, load_retention
from estimation.errors import MigrationError, ParameterError, StorageError
from estimation.numerics_version import NUMERICS_VERSION
from estimation.vehicle.vehicle_class import VehicleClass
from fleet_db.keeping.retention import Retention
from fleet_db.migrate import check_head
from fleet_db.raw import FileRawStore, RawStore
from fleet_db.session import ServerLimits, database_engine
from fleet_db.storage import SqlStorage
from ingest.live.status import Backoff

FIRST_DELAY_S, LONGEST_DELAY_S = 0.5, 10.0  # between attempts to reach it; each is twice the one before

Service = TypeVar("Service")

_log = logging.getLogger(__name__)


class SystemClock:
    """The machine's clock."""

    def now_ns(self) -> int:
        """Return nanoseconds UTC since the Unix epoch."""
        return time.time_ns()


def code_version() -> str:
    """Return what estimates carry as provenance: the version of the numerics.

    Two estimates with the same code version came from the same mathematics, also between releases.
    """
    return f"numerics {NUMERICS_VERSION}"


def process_name(number: int | None = None) -> str:
    """Return what others read of a process of this machine where it holds something."""
    return f"{socket.gethostname()}, process {os.getpid() if number is None else number}"


def _shipped_class(code: str) -> VehicleClass | None:
    from ingest.vehicle_class_schema import class_of_package  # noqa: PLC0415 - most transactions read no class

    return class_of_package(code)


def open_store(settings: Settings) -> SqlStorage:
    """Return the store of this deployment; refused at another migration, of other windows, or out of reach."""
    limits = ServerLimits(
        settings.database_connect_timeout_s, settings.database_silence_s, settings.database_statement_timeout_s
    )
    storage = SqlStorage(database_engine(settings.url, limits), settings.data_dir, _shipped_class)
    try:
        check_head(storage.engine)
        with storage.read() as unit:
            unit.settings.check_window_length(settings.window_length_ns)
    except ParameterError as error:
        storage.close()
        raise ParameterError(error.reason, field=f"{PREFIX}WINDOW_LENGTH_S") from None
    except Exception:
        storage.close()
        raise
    return storage


def raw_store(settings: Settings) -> RawStore:
    """Return where raw recordings are kept; a bucket is not asked yet, but its credentials must be there."""
    place = urlsplit(settings.raw_store or "")
    if place.scheme in {"", "file"}:
        return FileRawStore(Path(unquote(place.path)) if place.path else settings.data_dir / "raw")
    from api.bucket import bucket_store  # noqa: PLC0415 - most deployments have none

    return bucket_store(settings)


def retention_of(settings: Settings) -> Retention:
    """Return how long this deployment keeps what."""
    return Retention() if settings.retention_file is None else load_retention(settings.retention_file)


def once_the_database_answers(make: Callable[[], Service], settings: Settings, stopping: Event) -> Service | None:
    """Return what needs the database as soon as a server answers, SQLite at once; None after a stop."""
    delays, waited = Backoff(FIRST_DELAY_S, LONGEST_DELAY_S), False
    while not stopping.is_set():
        try:
            made = make()
        except MigrationError:
            raise
        except StorageError as error:
            if not settings.on_server:
                raise
            if not waited:
                _log.warning("the start waits for the database: %s", error)
            waited = True
        else:
            if waited:
                _log.info("the database answers, the start goes on")
            return made
        stopping.wait(delays.failed())
    return None
