"""What commands share: a transaction of the database of this deployment, who uses it, and lists in columns."""

from __future__ import annotations

import getpass
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager

from api.factory import open_store
from api.settings import load_settings
from fleet_db.storage import SqlUnitOfWork

NAMELESS = "command line"
"""Who is recorded where the user of the system has no name, as in a container."""


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


def columns(rows: Sequence[Sequence[str]]) -> str:
    """Return rows as lines whose cells stand below each other."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return "\n".join(
        "  ".join(text.ljust(width) for text, width in zip(row, widths, strict=True)).rstrip() for row in rows
    )
