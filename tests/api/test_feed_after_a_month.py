"""A client that was away for 30 days finds every event behind its cursor, whatever has been purged meanwhile."""

from __future__ import annotations

import time
from dataclasses import fields
from pathlib import Path

import api_fleet
import pytest
from populated_service import populated_service
from running_service import Service
from stored_raw import raw_of

from estimation.values.units import DAY_NS
from fleet_db.keeping.purge import purge
from fleet_db.keeping.retention import LEAST_DAYS_OF_RECORDINGS, Retention

FEED = "/v1/alerts/feed"
SHORTEST = Retention(**{field.name: 1.0 for field in fields(Retention)} | {"recordings": LEAST_DAYS_OF_RECORDINGS})


def _rest(service: Service, cursor: str) -> list[tuple[int, str]]:
    found: list[tuple[int, str]] = []
    while True:
        page = service.client.get(FEED, params={"after": cursor, "limit": "7"}).json()
        if not page["items"]:
            return found
        found += [(item["alert"]["id"], item["event"]) for item in page["items"]]
        cursor = page["next_cursor"]


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["sqlite", "postgresql"])
def test_thirty_days_away_and_the_shortest_retention_miss_nothing(
    kind: str, tmp_path: Path, postgres_server_url: str
) -> None:
    with populated_service(kind, tmp_path, postgres_server_url) as service:
        first = service.client.get(FEED, params={"limit": "5"}).json()
        behind = _rest(service, first["next_cursor"])
        written: list[tuple[int, str]] = []
        for day in range(1, 31):
            alert = api_fleet.raised(service.storage, api_fleet.WHEELSETS[day % 20], "hunting")
            taken = service.client.post(
                f"/v1/alerts/{alert.alert_id}/acknowledge",
                json={"by": "depot", "note": "done"},
                headers={"If-Match": "*"},
            )
            assert taken.status_code == 200, taken.text
            written += [(alert.alert_id, "raised"), (alert.alert_id, "acknowledged")]
            deleted = purge(
                service.storage, raw_of(service.storage), SHORTEST, time.time_ns() + day * DAY_NS, lambda: None
            )
            assert len(deleted) == len(fields(Retention))
        assert len(behind) > 5
        found = _rest(service, first["next_cursor"])
        assert found[: len(behind)] == behind
        assert [one for one in found[len(behind) :] if one in set(written)] == written
