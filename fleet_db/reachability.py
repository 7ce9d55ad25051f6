"""A database that is away is not asked by everyone at once.

A failed attempt to connect can take as long as its timeout. While the database is away only one caller at a time waits
for that; all others fail at once, so that a service keeps threads for what needs no database.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from sqlalchemy import Dialect, Engine, event
from sqlalchemy.pool import ConnectionPoolEntry

RETRY_S = 1.0
"""After a failure nobody tries to connect for this long, in seconds."""


@dataclass(slots=True)
class Reachability:
    """Whether the last attempt to connect failed, when, and with which message."""

    clock: Callable[[], float] = time.monotonic
    _lock: threading.Lock = field(default_factory=threading.Lock)
    _failure: tuple[float, str] | None = None
    _trying: bool = False

    def refusal(self) -> str | None:
        """Return why not to try now; None to the caller that may, who then reports what came of it."""
        with self._lock:
            if self._failure is None:
                return None
            failed_at_s, message = self._failure
            if self._trying or self.clock() - failed_at_s < RETRY_S:
                return message
            self._trying = True
            return None

    def succeeded(self) -> None:
        """Let everyone try from now on."""
        with self._lock:
            self._failure, self._trying = None, False

    def failed(self, message: str) -> None:
        """Let nobody try for a while."""
        with self._lock:
            self._failure, self._trying = (self.clock(), message), False


def guard_connecting(engine: Engine, open_connection: Callable[..., Any]) -> None:
    """Let the attempts of this engine to connect go through one :class:`Reachability`.

    The message of an attempt that failed is passed on without the password.
    """
    reachability = Reachability()

    def connect(dialect: Dialect, _entry: ConnectionPoolEntry, positional: list[Any], named: dict[str, Any]) -> Any:  # noqa: ANN401 - the driver's own type
        failure = dialect.loaded_dbapi.OperationalError
        refusal = reachability.refusal()
        if refusal is not None:
            raise failure(refusal)
        try:
            connection = open_connection(*positional, **named)
        except dialect.loaded_dbapi.Error as error:
            message = str(error)
            if named.get("password"):
                message = message.replace(str(named["password"]), "***")
            reachability.failed(message)
            raise failure(message) from None
        except BaseException:
            reachability.failed("the attempt to connect was broken off")
            raise
        reachability.succeeded()
        return connection

    event.listen(engine, "do_connect", connect)
