"""One page of the feed, read in one snapshot of the database; the filter that it is of, and the cursors between pages.

A database that was restored from a backup continues from an earlier event with others. A cursor from before the restore
is behind events that do not exist any more, and soon behind others that its client has never seen. So a cursor carries
the identity of its branch of the feed, and a check of its last event, which also finds a database that was restored by
other means than ``treadwatch restore``.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from http import HTTPStatus
from typing import Annotated, TypeVar
from urllib.parse import quote, urlencode

import orjson
from fastapi import Depends, Query

from api import cursors
from api.answers import RepresentationCache, payload_of
from api.asking import CODE
from api.problems import GoOn, ProblemError
from api.schemas import alerts
from api.schemas.alerts import KnownKind
from api.services import ServicesDep
from estimation.values.alerts import AlertEvent, Severity
from fleet_db.storage import SqlStorage, SqlUnitOfWork
from fleet_db.stores.installation import FeedBranch

MOST_VALUES = 50
FleetCode = Annotated[str, Query(pattern=CODE)]


@dataclass(frozen=True, slots=True)
class FeedFilter:
    """Which events are listed; an empty set is no filter."""

    fleets: frozenset[str] = frozenset()
    kinds: frozenset[str] = frozenset()
    severities: frozenset[str] = frozenset()  # an alert is followed to its end once it has had one of them
    visible: frozenset[str] | None = None  # codes of the fleets that the client may see; None for all

    @property
    def bound(self) -> Mapping[str, object]:
        """What a cursor is bound to; nothing for the whole feed."""
        return self.asked if self.visible is None else {**self.asked, "visible": sorted(self.visible)}

    @property
    def asked(self) -> Mapping[str, Sequence[str]]:
        """What a client asks for, by the name of the parameter."""
        named = {"fleet": self.fleets, "kind": self.kinds, "severity": self.severities}
        return {name: sorted(values) for name, values in named.items() if values}

    @property
    def chosen(self) -> dict[str, frozenset[str]]:
        """What the store is asked for."""
        return {"fleets": self.fleets, "kinds": self.kinds, "severities": self.severities}


async def _feed_filter(
    services: ServicesDep,
    fleet: Annotated[
        list[FleetCode] | None, Query(max_length=MOST_VALUES, description="Only of these fleets; may be repeated.")
    ] = None,
    kind: Annotated[
        list[KnownKind] | None, Query(max_length=MOST_VALUES, description="Only of these kinds; may be repeated.")
    ] = None,
    severity: Annotated[
        list[Severity] | None,
        Query(
            max_length=MOST_VALUES,
            description="Only alerts that have had one of these, from then on to their end; may be repeated.",
        ),
    ] = None,
) -> FeedFilter:
    return FeedFilter(_set(fleet), _set(kind), _set(severity), services.storage.visible_fleets)


def _set(values: Sequence[str] | None) -> frozenset[str]:
    return frozenset(str(value) for value in values or ())


FeedFilterDep = Annotated[FeedFilter, Depends(_feed_filter)]
_FORM = re.compile(r"(?P<sequence>\d{1,19})\.(?P<identity>[0-9a-f]{32})\.(?P<check>[0-9a-f]{8})", re.ASCII)
_NO_EVENT = "0" * 8
FEED = "poll_alert_feed"
"""Name of the operation that all cursors of the feed belong to, also those of its stream and its webhooks."""
HOW_TO_GO_ON = "read what is open now from /v1/alerts?open=true, then follow `next`"


@dataclass(frozen=True, slots=True)
class FeedCursor:
    """A place in the feed."""

    sequence: int
    identity: str
    check: str


def check_of(event: AlertEvent | None) -> str:
    """Return what a cursor keeps of its last event: enough to know another of the same number from it."""
    if event is None:
        return _NO_EVENT
    alert = event.alert
    subject = (alert.alert_id, alert.version, alert.fleet, alert.wheelset, alert.kind)
    facts = orjson.dumps([event.sequence, event.kind.value, event.recorded_ns, event.actor, *subject])
    return hashlib.blake2b(facts, digest_size=4).hexdigest()


def cursor_behind(narrowed: FeedFilter, branch: FeedBranch, event: AlertEvent | None) -> str:
    """Return the cursor behind an event."""
    sequence = 0 if event is None else event.sequence
    return cursors.encode(FEED, narrowed.bound, f"{sequence}.{branch.identity}.{check_of(event)}")


def cursor_of(narrowed: FeedFilter, cursor: str | None) -> FeedCursor | None:
    """Return what a cursor says; None without one."""
    key = cursors.decode(FEED, narrowed.bound, cursor)
    if key is None:
        return None
    form = _FORM.fullmatch(key) if isinstance(key, str) else None
    if form is None or int(form["sequence"]) >= cursors.INT64:
        raise cursors.refused()
    return FeedCursor(int(form["sequence"]), form["identity"], form["check"])


def event_of(unit: SqlUnitOfWork, narrowed: FeedFilter, path: str, cursor: FeedCursor | None) -> AlertEvent | None:
    """Return the event behind which the next poll begins; None at the beginning; 409: of another history."""
    if cursor is None:
        return None
    branches = unit.feed_branches.all()
    place = next((place for place, branch in enumerate(branches) if branch.identity == cursor.identity), None)
    if place is None:
        raise _of_another(path, "the cursor is of another database", None)
    shared = min((later.after_sequence for later in branches[place + 1 :]), default=None)
    if shared is not None and cursor.sequence > shared:
        begin = cursor_behind(narrowed, branches[-1], unit.alerts.last_in_feed(shared))
        raise _of_another(path, "the cursor is of this database before it was restored", begin)
    event = unit.alerts.event(cursor.sequence)
    if (event is None and cursor.sequence) or cursor.check != check_of(event):
        raise _of_another(path, "the database has another history than the cursor", None)
    return event


def _of_another(path: str, detail: str, begin: str | None) -> ProblemError:
    """Return the problem; ``begin`` is the cursor where the common history ends, None where nothing is known of it."""
    separator = "&" if "?" in path else "?"
    go_on = GoOn(path if begin is None else f"{path}{separator}after={begin}", begin)
    detail = f"{detail}: {HOW_TO_GO_ON}"
    return ProblemError(HTTPStatus.CONFLICT, "cursor-of-another-database", detail, go_on=go_on)


PageT = TypeVar("PageT")
LATEST = "latest"  # what a client sends as its cursor to begin behind the newest event


@dataclass(frozen=True, slots=True)
class Place:
    """A place in the feed."""

    sequence: int  # what matches up to this number has been handed over
    cursor: str


@dataclass(frozen=True, slots=True)
class FeedPage:
    """Events, and where they end."""

    events: Sequence[tuple[AlertEvent, str]]  # each with the cursor behind it, in commit order
    end: Place  # behind the last event, or behind all that there was where that were fewer than asked for
    newest: Place  # behind all that there was


def opened(
    storage: SqlStorage,
    narrowed: FeedFilter,
    path: str,
    after: str | None,
    read: Callable[[SqlUnitOfWork, FeedFilter, int], PageT],
) -> PageT:
    """Return the page behind a client's cursor; refused where it is of another filter (400) or history (409)."""
    given = cursor_of(narrowed, None if after == LATEST else after)
    with storage.read() as unit:
        if after == LATEST:
            return read(unit, narrowed, unit.feed_branches.newest_sequence())
        query = urlencode(narrowed.asked, doseq=True)
        last = event_of(unit, narrowed, quote(path) + (f"?{query}" if query else ""), given)
        return read(unit, narrowed, 0 if last is None else last.sequence)


def read_page(unit: SqlUnitOfWork, narrowed: FeedFilter, after_sequence: int, limit: int) -> FeedPage:
    """Return the page behind a place that is known to be of this database."""
    listed = unit.alerts.feed(after_sequence, limit, **narrowed.chosen)
    branch = unit.feed_branches.all()[-1]
    newest = newest_place(unit, narrowed, branch)
    events = [(event, cursor_behind(narrowed, branch, event)) for event in listed]
    end = newest if len(listed) < limit else Place(listed[-1].sequence, events[-1][1])
    return FeedPage(events, end, newest)


def newest_place(unit: SqlUnitOfWork, narrowed: FeedFilter, branch: FeedBranch) -> Place:
    """Return the end of the feed; its cursor names the newest event that the client may see."""
    return Place(unit.feed_branches.newest_sequence(), cursor_behind(narrowed, branch, unit.alerts.last_in_feed()))


@dataclass(frozen=True, slots=True)
class KeptPage:
    """The JSON text of events, in commit order, and where they end as in ``FeedPage``."""

    items: Sequence[bytes]
    end: Place


def read_kept(
    unit: SqlUnitOfWork, narrowed: FeedFilter, after_sequence: int, limit: int, cache: RepresentationCache
) -> KeptPage:
    """Return the page behind a place that is known to be of this database."""
    outlines = unit.alerts.feed_outlines(after_sequence, limit, **narrowed.chosen)

    def made(sequences: Sequence[int]) -> Mapping[int, bytes]:
        events = unit.alerts.some_events(sequences)
        return {sequence: payload_of(alerts.event(event)) for sequence, event in events.items()}

    keys = {event.sequence: ("event", event.sequence, event.alert_id, event.recorded_ns) for event in outlines}
    texts = cache.get_or_make_all(keys, made)
    branch = unit.feed_branches.all()[-1]
    if len(outlines) < limit:
        end = newest_place(unit, narrowed, branch)
    else:
        last = outlines[-1]
        key = ("cursor", last.sequence, last.alert_id, last.recorded_ns, branch.identity, narrowed)
        text = cache.get_or_make(
            key, lambda: cursor_behind(narrowed, branch, unit.alerts.event(last.sequence)).encode()
        )
        end = Place(last.sequence, text.decode())
    return KeptPage([texts[event.sequence] for event in outlines], end)
