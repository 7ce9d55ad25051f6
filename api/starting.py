"""A service that starts while its database server is away waits for it."""

from __future__ import annotations

import logging
from collections.abc import Callable
from threading import Event
from typing import TypeVar

from api.settings import Settings
from estimation.errors import MigrationError, StorageError
from ingest.live.backoff import Backoff

FIRST_DELAY_S, LONGEST_DELAY_S = 0.5, 10.0
"""Between attempts to reach it; each is twice the one before."""

Service = TypeVar("Service")

_log = logging.getLogger(__name__)


def once_the_database_answers(make: Callable[[], Service], settings: Settings, stopping: Event) -> Service | None:
    """Return what needs the database as soon as a server answers; None when a stop is asked for before.

    Args:
        settings: Of the deployment. A file of SQLite that cannot be opened is not waited for: nobody brings it back.
        stopping: Set by whoever ends the service.

    Raises:
        MigrationError: The database is at another migration.
        StorageError: The file of SQLite cannot be used.
    """
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
