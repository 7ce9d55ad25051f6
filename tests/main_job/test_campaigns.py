"""The main job, real and small: frames, recordings, windows, jobs, REST, on both databases."""

from __future__ import annotations

import json
import uuid
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import psycopg
import pytest
import sqlalchemy
from one_database import in_turn
from tiny_fleet import DEAD, WORN, Deployment, deployment, rows, true_conicity

from api.terminal.demo import free_port, serving_api
from api.times import from_rfc3339, to_rfc3339
from estimation.contact.profiles import MeasuredProfiles
from fleet_db.migrate import upgrade
from ingest.simulator.axle_motion import wear_at, worn_profiles
from ingest.simulator.fleet import FleetReport
from ingest.simulator.scenario_file import load_scenario


@dataclass(frozen=True)
class History:
    """A deployment that has been through all campaigns, its REST service, and what that said after each campaign."""

    fleet: Deployment
    client: httpx.Client
    earlier: tuple[tuple[str, Any, Any], ...]  # RFC 3339 time, geometry and trend of WORN


@pytest.fixture(scope="module", params=in_turn)
def history(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory, report: FleetReport
) -> Iterator[History]:
    folder = tmp_path_factory.mktemp("history")
    url = f"sqlite:///{folder / 'fleet.sqlite3'}"
    if request.param == "postgresql":
        url = request.getfixturevalue("history_postgres_url")
    upgrade(url)
    fleet = deployment(url, folder, report)
    settings = fleet.settings.model_copy(update={"port": free_port("127.0.0.1", 0), "log_level": "warning"})
    earlier = []
    with closing(fleet.storage), serving_api(settings) as base_url, httpx.Client(base_url=base_url) as client:
        for recording in report.recordings:
            fleet.campaign_over([recording])
            fleet.run_jobs()
            geometry, trend = (got(client, f"/v1/wheelsets/{WORN}/{what}") for what in ("geometry", "trend"))
            earlier.append((to_rfc3339(fleet.clock.at_ns), geometry, trend))
        yield History(fleet, client, tuple(earlier))


@pytest.fixture(scope="module")
def history_postgres_url(postgres_server_url: str) -> Iterator[str]:
    name = f"history_{uuid.uuid4().hex}"
    with psycopg.connect(postgres_server_url, autocommit=True) as connection:
        connection.execute(f'CREATE DATABASE "{name}"')
        yield sqlalchemy.make_url(postgres_server_url).set(database=name).render_as_string(hide_password=False)
        connection.execute(f'DROP DATABASE "{name}" WITH (FORCE)')


@pytest.fixture
def client(history: History) -> httpx.Client:
    return history.client


def got(client: httpx.Client, path: str, **query: str) -> Any:  # noqa: ANN401 - JSON
    answer = client.get(path, params=query)
    assert answer.status_code == 200, answer.text
    return answer.json()


@pytest.mark.parametrize("serial", [WORN, DEAD])
def test_the_conicity_over_rest_is_near_the_truth_and_its_intervals_cover(
    client: httpx.Client, report: FleetReport, serial: str
) -> None:
    geometry = got(client, f"/v1/wheelsets/{serial}/geometry")
    covered, errors = [], []
    for entry in geometry["conicity_by_amplitude"]:
        found = entry["equivalent_conicity_1"]
        if found["status"] != "estimated":
            assert found["value"] is None
            assert found["reason"]
            continue
        true = true_conicity(report.truth, serial, geometry["mileage_km"], entry["amplitude_mm"])
        low, high = found["interval_95"]
        covered.append(low <= true <= high)
        if 1.0 <= entry["amplitude_mm"] <= 2.5:
            errors.append(abs(found["value"] - true))
        assert high - low < 0.3
    assert len(covered) >= 8
    assert sum(covered) >= 0.8 * len(covered)
    assert len(errors) == 7
    assert sum(errors) / len(errors) < 0.03  # three minutes of data
    assert geometry["provenance"]["track_versions"] == {"T-3": [1]}


def test_a_wheelset_is_followed_from_its_bins_to_its_trend(client: httpx.Client) -> None:
    wheelset = got(client, f"/v1/wheelsets/{WORN}")
    geometry = got(client, wheelset["links"]["geometry"])
    assert geometry["baseline"] == 1  # it has been reprofiled between the second campaign and the third
    assert "estimated" in geometry["bins"]["rolling_radius_difference_mm"]["status"]
    trend = got(client, geometry["links"]["trend"])
    assert trend["points"]["mileage_km"] == pytest.approx([61_000, 91_000], abs=10)
    low, high = trend["slope_1_per_1000_km"]["interval_95"]
    assert low < trend["slope_1_per_1000_km"]["value"] < high
    assert high > 0


def test_a_sensor_that_died_makes_its_wheelset_unknown_and_never_healthy(client: httpx.Client) -> None:
    alerts = {alert["kind"]: alert for alert in got(client, "/v1/alerts", wheelset=DEAD, open="true")["items"]}
    assert alerts["conicity_limit"]["condition"] == "unknown"
    assert alerts["conicity_limit"]["evidence"]["unknown_because"]
    assert alerts["no_data"]["condition"] == "active"
    events = [event["event"] for event in got(client, "/v1/alerts/feed")["items"] if event["alert"]["wheelset"] == DEAD]
    assert "raised" in events
    assert not {"cleared", "closed"} & set(events)
    windows = got(client, f"/v1/wheelsets/{DEAD}/windows")["items"]
    assert {window["state"] for window in windows[-4:]} == {"refused"}
    assert all(window["reason"] for window in windows[-4:])


def test_what_was_believed_earlier_can_be_asked_for(history: History) -> None:
    for at, geometry, trend in history.earlier:
        assert got(history.client, f"/v1/wheelsets/{WORN}/geometry", as_of=at) == geometry
        assert got(history.client, f"/v1/wheelsets/{WORN}/trend", as_of=at) == trend
    assert len({geometry["equivalent_conicity_1"]["value"] for _, geometry, _ in history.earlier}) == 4
    assert [geometry["baseline"] for _, geometry, _ in history.earlier] == [0, 0, 1, 1]
    before = history.client.get(f"/v1/wheelsets/{WORN}/geometry", params={"as_of": "2024-01-01T00:00:00Z"})
    assert (before.status_code, before.json()["reason_code"]) == (200, "no_geometry")


def test_running_every_job_again_changes_no_row(history: History) -> None:
    before = rows(history.fleet.storage)
    assert len(before["results"]) >= 8
    for _ in range(2):
        counts = {run.job: run.counts for run in history.fleet.run_jobs()}
        assert counts["estimate_windows"]["estimated"] == counts["refresh_geometry"]["geometries"] == 0
        assert counts["refresh_trends"]["refreshed"] == counts["evaluate_alerts"]["raised"] == 0
    assert rows(history.fleet.storage) == before


def test_the_intervals_cover_the_wheels_as_they_were_measured(
    history: History, report: FleetReport, scenario_file: Path
) -> None:
    (plan,) = load_scenario(scenario_file).vehicles
    truth = json.loads(report.truth.read_text(encoding="utf-8"))["wheelsets"]
    with history.fleet.storage.write() as unit:
        for axle, facts in enumerate(truth):
            for campaign in facts["campaigns"]:
                worn = wear_at(plan.wheelsets[axle], 1e3 * campaign["odometer_km"])
                wheels = worn_profiles(plan.wheelsets[axle], worn)
                at_ns = from_rfc3339(campaign["start"]) + 3_600 * 10**9
                unit.registry.add_measured_profiles(
                    MeasuredProfiles(facts["serial"], at_ns, campaign["mileage_km"], *wheels, 0.05e-3)
                )
    found = got(history.client, "/v1/accuracy")
    assert found["on_file"] == found["considered"] == 8
    of = {(row["wheelset"], row["measured_at"]): row for row in found["measurements"]}
    for facts in truth:
        for campaign in facts["campaigns"]:
            row = of[facts["serial"], to_rfc3339(from_rfc3339(campaign["start"]) + 3_600 * 10**9)]
            at_3_mm = float(np.interp(3.0, campaign["amplitude_mm"], campaign["equivalent_conicity"]))
            assert row["measured_1"]["value"] == pytest.approx(at_3_mm, abs=1e-3), (
                "the contact search is that of the truth"
            )
            if campaign["sensor_failed"]:
                assert row["outcome"] == "not_compared"
                assert row["reason_code"] is not None
    pair = found["coverage"]
    assert pair["everything"] == pair["independent"], "the section is surveyed"
    assert pair["everything"]["compared"] >= 4
    assert pair["everything"]["covered"] >= 0.8 * pair["everything"]["compared"]
