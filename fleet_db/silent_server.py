"""A database server that is connected and says nothing: it is asked whether it is there, and given up where it is not.

A server that is frozen, or behind a link that swallows what is sent, keeps its connections open, and the kernel at its
end may go on acknowledging. Only its answers show that it is alive. A statement may take long for good reasons, though:
a lock that another process holds, many rows. So nothing is concluded from silence alone: after a while of it the server
has to accept another connection.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Generator
from dataclasses import dataclass
from typing import Any, Self, TypeVar, cast

import psycopg

Returned = TypeVar("Returned")
Waiting = Generator[Any, Any, Returned]
"""Of the driver: yields what it waits for on the socket, is sent what came, nothing at each of its intervals."""


@dataclass(frozen=True, slots=True)
class ServerLimits:
    """How long a database server may take.

    Attributes:
        connect_s: To accept a connection; the driver takes at least 2 s.
        silence_s: To say anything about a statement, before it is asked whether it is there.
        statement_s: For one statement; None without a limit.
    """

    connect_s: int = 5
    silence_s: float = 10.0
    statement_s: float | None = None

    def options(self) -> dict[str, int]:
        """Return the driver's options: also for a peer whose kernel has gone without a word."""
        return {
            "connect_timeout": self.connect_s,
            "keepalives_idle": max(1, round(self.silence_s)),
            "keepalives_interval": max(1, round(self.silence_s / 2)),
            "keepalives_count": 3,
            "tcp_user_timeout": round(2000 * self.silence_s),  # ms
        }


class WatchedConnection(psycopg.Connection[Any]):
    """A connection that ends with an error where the server is silent, and does not answer at another one either."""

    answered_s = float("-inf")
    """When the server answered it last, on the monotonic clock, in seconds."""
    _limits: ServerLimits | None = None
    _again: Callable[[], psycopg.Connection[Any]]

    @classmethod
    def open(cls, limits: ServerLimits, *positional: Any, **named: Any) -> Self:  # noqa: ANN401 - the driver's own
        """Return a connection within these limits.

        Args:
            positional, named: Of ``psycopg.connect``.

        Raises:
            psycopg.OperationalError: Nothing answered in time, or it refused.
        """
        connection = cls.connect(*positional, **named)
        connection.watch(limits, lambda: psycopg.connect(*positional, **named))
        return connection

    def watch(self, limits: ServerLimits, connect_again: Callable[[], psycopg.Connection[Any]]) -> None:
        """Look at the silence of the server from now on."""
        self._limits, self._again = limits, connect_again

    def wait(self, gen: Waiting[Returned], *positional: Any, **named: Any) -> Returned:  # noqa: ANN401 - the driver's own
        """Wait as the driver does, and look at the silence meanwhile.

        Raises:
            psycopg.OperationalError: The server was silent for too long and is not there, or the statement took too
                long.
        """
        watched = gen if self._limits is None else self._watch(gen, self._limits)
        return super().wait(watched, *positional, **named)

    def _watch(self, gen: Waiting[Returned], limits: ServerLimits) -> Waiting[Returned]:
        began_s = said_s = time.monotonic()
        # the server ends a statement that is late by itself, and has this long to say so
        late_s = None if limits.statement_s is None else limits.statement_s + limits.silence_s
        try:
            wanted = next(gen)
            while True:
                came = yield wanted
                now_s = time.monotonic()
                if came:
                    said_s = now_s
                elif late_s is not None and now_s - began_s >= late_s:
                    self._give_up(f"no end of a statement after {now_s - began_s:.0f} s")
                elif now_s - said_s >= limits.silence_s:
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
