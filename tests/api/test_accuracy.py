"""Estimates against measurements in the API: one wheelset, a fleet, and the contact geometry of a design."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import populated_fleet
import pytest
from measured_fleet import BARE, OTHER, SERIAL, measure
from running_service import running
from sqlalchemy import create_engine, text

from api.factory import open_store
from api.settings import Settings


@pytest.fixture
def client(storage_url: str, tmp_path: Path) -> Iterator[httpx.Client]:
    """Yield a client of a service over measured wheelsets: one near its estimate, one far from it, two without."""
    settings = Settings(data_dir=tmp_path, database_url=storage_url, port=0, log_level="warning", _env_file=None)
    storage = open_store(settings)
    populated_fleet.populate(storage)
    measure(storage)
    with running(settings) as address, httpx.Client(base_url=address, timeout=30.0) as found:
        yield found
    storage.close()


def comparison(client: httpx.Client, serial: str) -> dict[str, Any]:
    (one, *_) = client.get(f"/v1/wheelsets/{serial}/measured-profiles").json()["items"]
    found: dict[str, Any] = client.get(one["links"]["comparison"]).raise_for_status().json()
    return found


def test_a_measurement_is_shown_beside_the_estimate_of_its_date(client: httpx.Client) -> None:
    found = comparison(client, SERIAL)
    assert found["estimate"]["mileage_km"] == 9400.0
    assert found["estimate"]["mileage_apart_km"] == -100.0
    assert found["independent"] is True
    assert found["reason"] is None
    (rails,) = found["measured"]["rails"]
    assert rails == {"rail_profile": "56E1", "rail_inclination_1": 0.05, "nominal_gauge_mm": 1435.0, "share_1": 1.0}
    left, right = found["wheels"]["left"], found["wheels"]["right"]
    assert left["flange_height_mm"] == pytest.approx(31.0, abs=0.02)  # P8: 30.00, and 1 mm of tread is gone
    assert right["flange_height_mm"] == pytest.approx(30.0, abs=0.006)
    assert right["flange_thickness_mm"] == pytest.approx(29.94, abs=0.006)
    assert right["flange_gradient_mm"] == pytest.approx(12.13, abs=0.006)
    assert left["hollow_mm"] > right["hollow_mm"] == pytest.approx(0.0, abs=1e-3)
    assert found["estimated_wheels"]["reason_code"] == "measures_not_observable"
    pairs = found["conicity_by_amplitude"]
    assert [pair["amplitude_mm"] for pair in pairs] == [1, 2, 3, 4, 5, 6, 7, 8]
    three = pairs[2]
    assert three["estimated_1"]["interval_95"] == [0.22, 0.3]
    assert 0.2 < three["measured_1"]["value"] < 0.35
    assert three["measured_1"]["std"] > 0.0
    assert three["covered"] is True
    assert pairs[7]["estimated_1"]["value"] is None
    assert pairs[7]["estimated_1"]["reason_code"] == "amplitude_not_covered"
    assert pairs[7]["covered"] is None
    curve, bins = found["measured"]["curve"], found["measured_at_bins"]
    assert len({len(column) for column in curve.values()}) == 1
    assert curve["lateral_displacement_mm"][0] == -8.0
    assert len(bins["rolling_radius_difference_mm"]) == len(found["estimate"]["bins"]["lower_mm"]) == 16
    middle = [value for value in bins["rolling_radius_difference_mm"] if value is not None]
    assert np.mean(middle) == pytest.approx(0.0, abs=0.05), "counted from the origin, as the estimate is"


def test_the_fleet_is_counted_and_what_is_not_covered_or_not_compared_is_named(client: httpx.Client) -> None:
    found = client.get("/v1/accuracy").raise_for_status().json()
    assert found["on_file"] == found["considered"] == 6  # three of them of a wheelset whose estimates have no mileage
    assert found["coverage"]["everything"] == found["coverage"]["independent"]
    assert found["coverage"]["everything"]["compared"] == 2
    assert found["coverage"]["everything"]["covered"] == 1
    low, high = found["coverage"]["everything"]["fraction_interval_95_1"]
    assert (low, high) == pytest.approx((0.0608, 0.9392), abs=2e-3)  # Jeffreys, 1 of 2
    rows = [row["z_1"] for row in found["measurements"] if row["z_1"] is not None]
    assert len(rows) == 2
    assert found["coverage"]["everything"]["z_rms_1"] == pytest.approx(np.sqrt(np.mean(np.square(rows))))
    assert found["coverage"]["everything"]["mean_z_1"] == pytest.approx(np.mean(rows))
    outcomes = {row["wheelset"]: row for row in found["measurements"]}
    assert outcomes[SERIAL]["outcome"] == "covered"
    assert outcomes[SERIAL]["vehicle_class"] == "regional"
    assert outcomes[SERIAL]["track_sections"] == ["S-1"]
    assert outcomes[OTHER]["outcome"] == "not_covered"
    assert outcomes[OTHER]["vehicle_class"] is None
    assert outcomes[BARE]["outcome"] == "not_compared"
    assert outcomes[BARE]["reason_code"] == "no_geometry"
    assert outcomes[BARE]["measured_1"]["value"] is not None, "all sections have the same rails"
    assert sum(one["measurements"] for one in found["not_compared"]) == 4
    (of_class,) = found["coverage_by_vehicle_class"]
    assert (of_class["key"], of_class["everything"]["compared"]) == ("regional", 1)
    (of_section,) = found["coverage_by_track_section"]
    assert (of_section["key"], of_section["everything"]["compared"]) == ("S-1", 2)
    by_amplitude = {one["amplitude_mm"]: one["everything"]["compared"] for one in found["coverage_by_amplitude"]}
    assert by_amplitude == {1: 2, 2: 2, 3: 2, 4: 0, 5: 0, 6: 0, 7: 0, 8: 0}


def test_the_count_is_bounded_filtered_and_a_table(client: httpx.Client) -> None:
    newest = client.get("/v1/accuracy", params={"limit": 2}).json()
    assert (newest["on_file"], newest["considered"]) == (6, 2)
    assert client.get("/v1/accuracy", params={"fleet": "alpha"}).json()["considered"] == 5
    until = client.get("/v1/accuracy", params={"to": "2025-06-18T00:00:00Z"}).json()
    assert {row["wheelset"] for row in until["measurements"]} == {SERIAL, OTHER, BARE}
    assert client.get("/v1/accuracy", params={"fleet": "none"}).status_code == 404
    assert client.get("/v1/accuracy", params={"limit": 501}).status_code == 422
    body = client.get("/v1/accuracy", headers={"Accept": "text/csv"}).text
    rows = {row["wheelset"]: row for row in csv.DictReader(io.StringIO(body))}
    assert rows[OTHER]["outcome"] == "not_covered"
    assert float(rows[OTHER]["z_1"]) > 1.96
    assert float(rows[OTHER]["estimated_low_1"]) == pytest.approx(0.56)
    unknown = client.get(f"/v1/wheelsets/{SERIAL}/measured-profiles/2020-01-01T00:00:00Z/comparison")
    assert unknown.status_code == 404


def test_a_design_has_a_contact_geometry_on_the_rails_of_the_estimate(client: httpx.Client) -> None:
    found = client.get(f"/v1/wheelsets/{SERIAL}/contact").raise_for_status().json()
    assert (found["wheel_profile"], found["contact"]["status"]) == ("P8", "estimated")
    at_3 = found["contact"]["conicity_by_amplitude"][2]["equivalent_conicity_1"]
    assert at_3["value"] == pytest.approx(0.195, abs=0.01)  # P8 on 56E1 1:20 at 1435 mm
    assert at_3["std"] == 0.0
    table = client.get(f"/v1/wheelsets/{SERIAL}/contact", headers={"Accept": "text/csv"}).text.splitlines()
    assert table[0].startswith("lateral_displacement_mm,rolling_radius_sum_mm")
    assert len(table) == 162
    again = client.get(f"/v1/wheelsets/{SERIAL}/contact")
    assert client.get(again.url, headers={"If-None-Match": again.headers["etag"]}).status_code == 304


def test_a_damaged_measurement_is_named_and_keeps_no_other_from_being_compared(
    client: httpx.Client, storage_url: str
) -> None:
    engine = create_engine(storage_url)
    with engine.begin() as connection:
        connection.execute(
            text("UPDATE measured_profiles SET packed = :torn WHERE wheelset = :one"), {"torn": b"PK", "one": OTHER}
        )
    engine.dispose()
    found = client.get("/v1/accuracy").raise_for_status().json()
    (unreadable,) = found["unreadable"]
    assert (unreadable["wheelset"], unreadable["reason_code"]) == (OTHER, "file_damaged")
    assert OTHER in unreadable["reason"]
    assert (found["on_file"], found["considered"], found["coverage"]["everything"]["compared"]) == (6, 5, 1)
    assert {row["wheelset"] for row in found["measurements"]} >= {SERIAL, BARE}
