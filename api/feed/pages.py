"""One page of the feed, read in one snapshot of the database."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeVar
from urllib.parse import quote, urlencode

from api.feed import cursors
from api.feed.filters import FeedFilter
from estimation.values.alerts import AlertEvent
from fleet_db.storage import SqlStorage, SqlUnitOfWork
from fleet_db.stores.installation import FeedBranch

PageT = TypeVar("PageT")
LATEST = "latest"
"""What a client sends as its cursor to begin behind the newest event."""


@dataclass(frozen=True, slots=True)
class Place:
    """A place in the feed.

    Args:
        sequence: What matches up to this number has been handed over.
        cursor: The same for clients.
    """

    sequence: int
    cursor: str


@dataclass(frozen=True, slots=True)
class FeedPage:
    """Events, and where they end.

    Args:
        events: Each with the cursor behind it, in commit order.
        end: Behind the last event, or behind all that there was where that were fewer than asked for.
        newest: Behind all that there was.
    """

    events: Sequence[tuple[AlertEvent, str]]
    end: Place
    newest: Place


def opened(
    storage: SqlStorage,
    narrowed: FeedFilter,
    path: str,
    after: str | None,
    read: Callable[[SqlUnitOfWork, FeedFilter, int], PageT],
) -> PageT:
    """Return the page behind a client's cursor.

    Args:
        narrowed: The client's filter.
        after: The cursor; None for the beginning, ``latest`` for the end.
        read: Reads the page behind a number.

    Raises:
        ProblemError: 400: the cursor is none of the feed under this filter; 409: it is of another history of the
            database.
    """
    given = cursors.decode(narrowed, None if after == LATEST else after)
    with storage.read() as unit:
        if after == LATEST:
            return read(unit, narrowed, unit.feed_branches.newest_sequence())
        last = cursors.position(unit, narrowed, with_filter(path, narrowed), given)
        return read(unit, narrowed, 0 if last is None else last.sequence)


def read_page(unit: SqlUnitOfWork, narrowed: FeedFilter, after_sequence: int, limit: int) -> FeedPage:
    """Return the page behind a place that is known to be of this database.

    Args:
        after_sequence: Number of the last event that was handed over.
        limit: How many events at most.
    """
    found = unit.alerts.feed(
        after_sequence, limit, fleets=narrowed.fleets, kinds=narrowed.kinds, severities=narrowed.severities
    )
    branch = unit.feed_branches.all()[-1]
    newest = newest_place(unit, narrowed, branch)
    events = [(event, cursors.encode(narrowed, branch, event)) for event in found]
    end = newest if len(found) < limit else Place(found[-1].sequence, events[-1][1])
    return FeedPage(events, end, newest)


def with_filter(path: str, narrowed: FeedFilter) -> str:
    """Return a path with the filter as its query."""
    named = (("fleet", narrowed.fleets), ("kind", narrowed.kinds), ("severity", narrowed.severities))
    given = [(name, value) for name, values in named for value in sorted(values)]
    return quote(path) + (f"?{urlencode(given)}" if given else "")


def newest_place(unit: SqlUnitOfWork, narrowed: FeedFilter, branch: FeedBranch) -> Place:
    """Return the end of the feed; its cursor names the newest event that the client may see."""
    return Place(unit.feed_branches.newest_sequence(), cursors.encode(narrowed, branch, unit.alerts.last_in_feed()))
