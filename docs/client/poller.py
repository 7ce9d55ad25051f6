"""Hand the events of the alert feed to a maintenance system, in order; with --follow until Ctrl-C is pressed."""

import os
import sys
import time
from pathlib import Path

from treadwatch_client import AuthenticatedClient
from treadwatch_client.api.alerts import poll_alert_feed
from treadwatch_client.models import Event, Feed, Problem

STATE = Path(os.environ.get("POLLER_STATE", "poller.cursor"))


def hand_over(event: Event) -> None:
    alert = event.alert
    print(
        event.event.value, alert.id, alert.severity.value, alert.kind.value, alert.wheelset or alert.fleet, flush=True
    )


def poll(client: AuthenticatedClient) -> None:
    cursor = STATE.read_text() if STATE.exists() else None
    page = poll_alert_feed.sync(client=client, after=cursor, limit=1000)
    if not isinstance(page, Feed):
        sys.exit(page.detail or page.title if isinstance(page, Problem) else "an answer that is not in the document")
    for event in page.items:
        hand_over(event)
    STATE.write_text(page.next_cursor)


with AuthenticatedClient(os.environ["TREADWATCH_URL"], os.environ["TREADWATCH_KEY"]) as treadwatch:
    poll(treadwatch)
    while "--follow" in sys.argv:
        time.sleep(10)
        poll(treadwatch)
