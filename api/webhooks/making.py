"""Making a webhook and moving it in the feed, for the command line and for the REST API."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace

from api.feed import pages as feed_cursors
from api.feed.pages import LATEST, FeedFilter
from api.problems import ProblemError
from api.services import require_known
from api.webhooks.cloud_events import new_secret
from estimation.errors import ConflictError
from fleet_db.storage import SqlUnitOfWork
from fleet_db.webhook_records import Webhook, WebhookState

MOST_WEBHOOKS = 200


@dataclass(frozen=True, slots=True)
class Wanted:
    """A webhook that is to be made.

    Args:
        fleets, kinds, severities: Which events; an empty set is no filter.
        bound: Codes of the fleets of who makes it; None for all.
    """

    url: str
    description: str
    fleets: frozenset[str]
    kinds: frozenset[str]
    severities: frozenset[str]
    bound: frozenset[str] | None


def make_webhook(unit: SqlUnitOfWork, wanted: Wanted, by: str, now_ns: int) -> tuple[Webhook, str]:
    """Make a webhook that begins with what happens from now on; return it with its secret. Too many are refused."""
    if len(unit.webhooks.page(None, MOST_WEBHOOKS)) == MOST_WEBHOOKS:
        raise ConflictError(f"there are {MOST_WEBHOOKS} webhooks, which is the most", kind="webhook")
    for fleet in sorted(wanted.fleets):
        require_known(unit, fleet=fleet)
    secret = new_secret()
    made = Webhook(
        webhook_id=0,
        **asdict(wanted),
        state=WebhookState.ACTIVE,
        disabled_reason=None,
        since_ns=now_ns,
        created_ns=now_ns,
        created_by=by,
        position=unit.feed_branches.newest_sequence(),
    )
    return unit.webhooks.add(made, secret), secret


def in_state(webhook: Webhook, state: WebhookState, now_ns: int) -> Webhook:
    """Return a webhook as a person puts it: one that is active again is no longer disabled."""
    if state is webhook.state:
        return webhook
    return replace(webhook, state=state, disabled_reason=None, since_ns=now_ns)


def place_of(unit: SqlUnitOfWork, webhook: Webhook, after: str | None, from_ns: int | None, path: str) -> int:
    """Return the number of the event behind which a webhook goes on: a time, a cursor or ``latest``."""
    if from_ns is not None:
        return unit.webhooks.last_before(from_ns)
    if after == LATEST:
        return unit.feed_branches.newest_sequence()
    whole = FeedFilter(visible=webhook.bound)
    own = replace(whole, fleets=webhook.fleets, kinds=webhook.kinds, severities=webhook.severities)
    try:
        narrowed, given = whole, feed_cursors.cursor_of(whole, after)
    except ProblemError:
        narrowed, given = own, feed_cursors.cursor_of(own, after)
    last = feed_cursors.event_of(unit, narrowed, path, given)
    return 0 if last is None else last.sequence


def handled_up_to(unit: SqlUnitOfWork, webhook: Webhook) -> int:
    """Return the number of the event up to which nothing waits for a webhook under the filter that it has.

    Another filter must not bring what this one has left out.
    """
    fleets = webhook.fleets or webhook.bound or frozenset()
    waits = unit.alerts.feed(webhook.position, 1, fleets=fleets, kinds=webhook.kinds, severities=webhook.severities)
    newest = unit.feed_branches.newest_sequence()
    return max(webhook.position, waits[0].sequence - 1 if waits else newest)
