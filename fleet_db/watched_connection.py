"""Connections to PostgreSQL that end with an error where the server is silent, and leave no transaction standing."""

from __future__ import annotations

import time
from collections.abc import Callable, Generator, Iterable
from typing import Any, Self, TypeVar, cast

import psycopg

Returned = TypeVar("Returned")
Waiting = Generator[Any, Any, Returned]
"""Of the driver: yields what it waits for on the socket, is sent what came, nothing at each of its intervals."""


class EndedPipelineCursor(psycopg.Cursor[Any]):
    """A cursor that asks for something plain after it has sent several rows.

    The driver sends them in a pipeline, after which the server does not end a transaction in which nothing happens any
    more until it has answered something else: a process that stands still there would keep its locks from all others.
    """

    def executemany(self, query: Any, params_seq: Iterable[Any], *, returning: bool = False) -> None:  # noqa: ANN401
        """Execute a statement for each row."""
        super().executemany(query, params_seq, returning=returning)
        with psycopg.Cursor(self.connection) as plain:
            plain.execute("SELECT 1")


class WatchedConnection(psycopg.Connection[Any]):
    """A connection that ends with an error where the server is silent, and does not answer at another one either."""

    answered_s = float("-inf")
    """When the server answered it last, on the monotonic clock, in seconds."""
    _silence_s: float | None = None
    _statement_s: float | None = None
    _again: Callable[[], psycopg.Connection[Any]]

    @classmethod
    def open(cls, silence_s: float, statement_s: float | None, *positional: Any, **named: Any) -> Self:  # noqa: ANN401 - the driver's own
        """Return a connection within ``ServerLimits``; OperationalError: nothing answered in time, or it refused."""
        connection = cls.connect(*positional, **named)
        connection.watch(silence_s, statement_s, lambda: psycopg.connect(*positional, **named))
        return connection

    def watch(
        self, silence_s: float, statement_s: float | None, connect_again: Callable[[], psycopg.Connection[Any]]
    ) -> None:
        """Look at the silence of the server from now on."""
        self._silence_s, self._statement_s, self._again = silence_s, statement_s, connect_again

    def wait(self, gen: Waiting[Returned], *positional: Any, **named: Any) -> Returned:  # noqa: ANN401 - the driver's own
        """Wait as the driver does, and look at the silence meanwhile; OperationalError: it was too long."""
        watched = gen if self._silence_s is None else self._watch(gen, self._silence_s)
        return super().wait(watched, *positional, **named)

    def _watch(self, gen: Waiting[Returned], silence_s: float) -> Waiting[Returned]:
        began_s = said_s = time.monotonic()
        # the server ends a statement that is late by itself, and has this long to say so
        late_s = None if self._statement_s is None else self._statement_s + silence_s
        try:
            wanted = next(gen)
            while True:
                came = yield wanted
                now_s = time.monotonic()
                if came:
                    said_s = now_s
                elif late_s is not None and now_s - began_s >= late_s:
                    self._give_up(f"no end of a statement after {now_s - began_s:.0f} s")
                elif now_s - said_s >= silence_s:
                    self._ask_whether_there(now_s - said_s)
                    said_s = time.monotonic()
                wanted = gen.send(came)
        except StopIteration as end:
            self.answered_s = time.monotonic()
            return cast("Returned", end.value)

    def _ask_whether_there(self, silent_s: float) -> None:
        try:
            self._again().close()
        except psycopg.Error:  # without its cause: it may repeat the password
            self._give_up(f"no answer for {silent_s:.0f} s, and none to a new connection")

    def _give_up(self, why: str) -> None:
        self.pgconn.finish()
        raise psycopg.OperationalError(f"the server is silent: {why}") from None
