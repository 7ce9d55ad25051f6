"""SQL statements that a test counts: its own, not those of threads beside it, which prolong leases as time passes."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager

from sqlalchemy import Engine, event


@contextmanager
def executed_statements() -> Iterator[list[str]]:
    """Yield the statements that this thread executes on any database."""
    executed: list[str] = []
    own = threading.get_ident()

    def keep(_connection: object, _cursor: object, statement: str, *_: object) -> None:
        if threading.get_ident() == own:
            executed.append(statement)

    event.listen(Engine, "before_cursor_execute", keep)
    try:
        yield executed
    finally:
        event.remove(Engine, "before_cursor_execute", keep)
