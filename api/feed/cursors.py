"""Cursors of the feed: where the last poll ended, in which database, and behind which event.

A database that was restored from a backup continues from an earlier event with others. A cursor from before the restore
is behind events that do not exist any more, and soon behind others that its client has never seen. So a cursor carries
the identity of its branch of the feed, and a check of its last event, which also finds a database that was restored by
other means than ``treadwatch restore``.
"""

from __future__ import annotations

import hashlib
import re
from dataclasses import dataclass
from http import HTTPStatus

import orjson

from api import cursors
from api.feed.filters import FeedFilter
from api.problems import GoOn, ProblemError
from estimation.values.alerts import AlertEvent
from fleet_db.storage import SqlUnitOfWork
from fleet_db.stores.installation import FeedBranch

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
    """Return what a cursor keeps of its last event: enough to know another of the same number from it.

    Args:
        event: None before the first.
    """
    if event is None:
        return _NO_EVENT
    alert = event.alert
    subject = (alert.alert_id, alert.version, alert.fleet, alert.wheelset, alert.kind)
    facts = orjson.dumps([event.sequence, event.kind.value, event.recorded_ns, event.actor, *subject])
    return hashlib.blake2b(facts, digest_size=4).hexdigest()


def encode(narrowed: FeedFilter, branch: FeedBranch, event: AlertEvent | None) -> str:
    """Return the cursor behind an event.

    Args:
        event: The last one seen; None at the beginning.
    """
    sequence = 0 if event is None else event.sequence
    return cursors.encode(FEED, narrowed.bound, f"{sequence}.{branch.identity}.{check_of(event)}")


def decode(narrowed: FeedFilter, cursor: str | None) -> FeedCursor | None:
    """Return what a cursor says; None without one.

    Raises:
        ProblemError: 400: it is none of the feed under this filter.
    """
    key = cursors.decode(FEED, narrowed.bound, cursor)
    if key is None:
        return None
    form = _FORM.fullmatch(key) if isinstance(key, str) else None
    if form is None or int(form["sequence"]) >= cursors.INT64:
        raise cursors.refused("this is no cursor of this list")
    return FeedCursor(int(form["sequence"]), form["identity"], form["check"])


def position(unit: SqlUnitOfWork, narrowed: FeedFilter, path: str, cursor: FeedCursor | None) -> AlertEvent | None:
    """Return the event behind which the next poll begins; None at the beginning.

    Raises:
        ProblemError: 409: the cursor is of another database, or of this one before it was restored; with where to go
            on.
    """
    if cursor is None:
        return None
    branches = unit.feed_branches.all()
    place = next((place for place, branch in enumerate(branches) if branch.identity == cursor.identity), None)
    if place is None:
        raise _of_another(path, "the cursor is of another database", None)
    shared = min((later.after_sequence for later in branches[place + 1 :]), default=None)
    if shared is not None and cursor.sequence > shared:
        begin = encode(narrowed, branches[-1], unit.alerts.last_in_feed(shared))
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
