"""A wheelset over its life in the API: intervals of all baselines, windows counted over time."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import api_fleet as fleet
import httpx
import populated_fleet
import pytest
from running_service import running

from api.factory import open_store
from api.settings import Settings
from bench.put_values import put_geometry
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.windows import WindowState

SERIAL = fleet.WHEELSETS[0]


@pytest.fixture
def client(storage_url: str, tmp_path: Path) -> Iterator[httpx.Client]:
    """Yield a client of a service that knows intervals of two baselines, and windows of 300 days."""
    settings = Settings(data_dir=tmp_path, database_url=storage_url, port=0, log_level="warning", _env_file=None)
    storage = open_store(settings)
    populated_fleet.populate(storage)
    with storage.write() as unit:
        for place, (baseline, interval) in enumerate([(0, 3), (0, 4), (1, 0)]):
            record = fleet.geometry_record(fleet.RECORDED, 0.2 + 0.01 * place)
            from_ns = fleet.START + place * fleet.DAY
            km = 1000.0 * place + 500.0
            put_geometry(unit, replace(record, baseline=baseline, interval=interval, mileage_km=km, from_ns=from_ns))
        late = replace(fleet.window(0), start_ns=fleet.window(0).start_ns + 299 * fleet.DAY)
        unit.windows.put(late, 20_000.0, fleet.RECORDED)
        for index in range(4):
            reason = None if index else Reason(ReasonCode.CLIPPED, "at the limit of its range")
            state = WindowState.ESTIMATED if index else WindowState.REFUSED
            unit.windows.mark(SERIAL, fleet.window(index).start_ns, state, reason)
    with running(settings) as address, httpx.Client(base_url=address, timeout=30.0) as found:
        yield found
    storage.close()


def test_intervals_of_all_baselines_are_listed_in_the_order_of_time(client: httpx.Client) -> None:
    page = client.get(f"/v1/wheelsets/{SERIAL}/intervals", params={"limit": 2}).raise_for_status().json()
    rest = client.get(page["next"]).json()
    found = page["items"] + rest["items"]
    assert [(one["baseline"], one["interval"]) for one in found] == [(0, 3), (0, 4), (1, 0)]
    assert [one["mileage_km"] for one in found] == [500.0, 1500.0, 2500.0]
    assert rest["next"] is None
    assert client.get("/v1/wheelsets/none/intervals").status_code == 404


def test_windows_are_counted_over_time_by_state_and_reason(client: httpx.Client) -> None:
    found = client.get(f"/v1/wheelsets/{SERIAL}/data-quality").raise_for_status().json()
    first, last = found["over_time"]
    counts = {(one["state"], one["reason_code"]): one["windows"] for one in first["windows_by_reason"]}
    assert counts == {("estimated", None): 3, ("refused", "clipped"): 1, ("pending", None): fleet.WINDOWS - 4}
    assert [one["windows"] for one in last["windows_by_reason"]] == [1]
    assert first["measured_from"] == "2025-06-15T00:00:00Z"
    assert first["measured_to"] == "2025-06-18T00:00:00Z", "300 days in at most 100 stretches"
    assert [one["windows"] for one in found["total"]] == [fleet.WINDOWS - 4 + 1, 3, 1]
    codes = [(one["state"], one["reason_code"]) for one in found["total"]]
    assert codes == [("pending", "waits_for_estimation"), ("estimated", None), ("refused", "clipped")]
    nothing = client.get(f"/v1/wheelsets/{fleet.NO_DATA_YET}/data-quality").json()
    assert (nothing["total"], nothing["over_time"]) == ([], [])
