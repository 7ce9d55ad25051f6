"""One page of the feed as it is sent; the text of an event is made once, for an event never changes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from api.answers import RepresentationCache, payload_of
from api.feed import cursors
from api.feed.filters import FeedFilter
from api.feed.pages import Place, newest_place
from api.schemas import alerts
from fleet_db.storage import SqlUnitOfWork
from fleet_db.stores.installation import FeedBranch


@dataclass(frozen=True, slots=True)
class KeptPage:
    """The JSON text of events, in commit order, and where they end as in ``FeedPage``."""

    items: Sequence[bytes]
    end: Place


def read_kept(
    unit: SqlUnitOfWork, narrowed: FeedFilter, after_sequence: int, limit: int, cache: RepresentationCache
) -> KeptPage:
    """Return the page behind a place that is known to be of this database.

    Args:
        after_sequence: Number of the last event that was handed over.
        limit: How many events at most.
    """
    found = unit.alerts.feed_outlines(
        after_sequence, limit, fleets=narrowed.fleets, kinds=narrowed.kinds, severities=narrowed.severities
    )

    def made(sequences: Sequence[int]) -> Mapping[int, bytes]:
        events = unit.alerts.some_events(sequences)
        return {sequence: payload_of(alerts.event(event)) for sequence, event in events.items()}

    keys = {one.sequence: ("event", one.sequence, one.alert_id, one.recorded_ns) for one in found}
    texts = cache.get_or_make_all(keys, made)
    branch = unit.feed_branches.all()[-1]
    if len(found) < limit:
        end = newest_place(unit, narrowed, branch)
    else:
        last = found[-1]
        key = ("cursor", last.sequence, last.alert_id, last.recorded_ns, branch.identity, narrowed)
        text = cache.get_or_make(key, lambda: _cursor(unit, narrowed, branch, last.sequence))
        end = Place(last.sequence, text.decode())
    return KeptPage([texts[one.sequence] for one in found], end)


def _cursor(unit: SqlUnitOfWork, narrowed: FeedFilter, branch: FeedBranch, sequence: int) -> bytes:
    return cursors.encode(narrowed, branch, unit.alerts.event(sequence)).encode()
