"""What commands share: the database of this deployment, who uses it, and how its lines are written."""

from __future__ import annotations

import getpass
import time
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from typing import TYPE_CHECKING

from api.factory import open_store
from api.settings import load_settings
from api.times import to_rfc3339
from fleet_db.records import AuditEntry
from fleet_db.storage import SqlUnitOfWork

if TYPE_CHECKING:
    from rich.console import Console

NAMELESS = "command line"  # who is recorded where the user of the system has no name, as in a container


@contextmanager
def reading() -> Iterator[SqlUnitOfWork]:
    """Return a reading transaction of the database that the settings name."""
    with closing(open_store(load_settings())) as storage, storage.read() as unit:
        yield unit


@contextmanager
def writing() -> Iterator[SqlUnitOfWork]:
    """Return a writing transaction of the database that the settings name."""
    with closing(open_store(load_settings())) as storage, storage.write() as unit:
        yield unit


def user_name() -> str:
    """Return the name of the user of the system."""
    try:
        return getpass.getuser()
    except (KeyError, OSError, ImportError):
        return NAMELESS


def user_here() -> str:
    """Return who is recorded with what the command line does."""
    name = user_name()
    return f"the {NAMELESS}" if name == NAMELESS else f"{name} at the command line"


def print_line(console: Console, text: str, style: str | None = None) -> None:
    """Print a line as it is, however long."""
    console.print(text, style=style, highlight=False, soft_wrap=True)


def columns(rows: Sequence[Sequence[str]]) -> str:
    """Return rows as lines whose cells stand below each other."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return "\n".join(
        "  ".join(text.ljust(width) for text, width in zip(row, widths, strict=True)).rstrip() for row in rows
    )


def second_text(at_ns: int | None) -> str:
    """Return a time to the second; None is never."""
    return "never" if at_ns is None else to_rfc3339(at_ns - at_ns % 1_000_000_000)


def note(unit: SqlUnitOfWork, kind: str, what: str, name: str) -> None:
    """Record in the audit log what the command line did."""
    now_ns, path = time.time_ns(), f"/v1/{kind}/{name}"
    unit.audit.add([AuditEntry(now_ns, user_here(), None, kind, what, 0, path, None, None)])
