"""What the resources say, in which units, and how they link."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any

import api_fleet
import httpx
import numpy as np
import pytest
from running_service import Service

from api.schemas import geometry as geometry_schema
from api.schemas import trend as trend_schema
from bench.put_values import put_geometry
from estimation.errors import ParameterError
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.trend import BeyondReached, FleetWear
from fleet_db.keeping.purge import Purged, record_purge
from fleet_db.keeping.retention import Kept


def get(client: httpx.Client, path: str, **params: str | int) -> Any:  # noqa: ANN401 - JSON
    response = client.get(path, params=params or None)
    assert response.status_code == 200, response.text
    assert response.headers["content-type"] == "application/json"
    return response.json()


def test_a_wheelset_leads_to_its_bin_table_its_trend_and_its_alerts(client: httpx.Client) -> None:
    first = get(client, "/v1/wheelsets")["items"][0]
    wheelset = get(client, first["links"]["self"])
    assert wheelset.items() < first.items()
    assert wheelset["serial"] == "WS-000"
    assert wheelset["nominal_radius_mm"] == 437.5
    assert wheelset["mounting"]["vehicle"] == "V-0"
    assert [one["mileage_km"] for one in wheelset["reprofilings"]] == [5000.5, 9000.0]
    geometry = get(client, wheelset["links"]["geometry"])
    trend = get(client, geometry["links"]["trend"])
    alerts = get(client, trend["links"]["alerts"])
    assert {alert["wheelset"] for alert in alerts["items"]} == {"WS-000"}
    assert {alert["kind"] for alert in alerts["items"]} >= {"conicity_limit", "no_data"}
    assert get(client, alerts["items"][0]["links"]["geometry"]) == geometry


def test_every_link_of_every_resource_can_be_followed(client: httpx.Client) -> None:
    waiting, seen = ["/v1/fleets", "/v1/wheelsets?limit=2", "/v1/jobs", "/v1/track-sections", "/v1/alerts"], set()
    while waiting:
        path = waiting.pop()
        if path in seen:
            continue
        seen.add(path)
        response = client.get(path)
        if path.endswith(("/geometry", "/trend", "/alignment", "/alignment-report")) and not path.startswith(
            "/v1/wheelsets/WS-000"
        ):
            assert response.status_code in {200, 404}
        else:
            assert response.status_code == 200, path
        waiting += [link for links in _links(response.json()) for link in links.values()]
    assert len(seen) > 50


def _links(value: object) -> list[dict[str, str]]:
    if isinstance(value, dict):
        own = [value["links"]] if "links" in value else []
        return own + [found for one in value.values() for found in _links(one)]
    if isinstance(value, list):
        return [found for one in value for found in _links(one)]
    return []


def test_a_bin_table_has_all_four_combinations_and_no_number_that_was_not_estimated(client: httpx.Client) -> None:
    bins = get(client, "/v1/wheelsets/WS-000/geometry")["bins"]
    assert bins["lower_mm"] == [-4.0, -2.0, 0.0, 2.0]
    assert bins["upper_mm"] == [-2.0, 0.0, 2.0, 4.0]
    assert bins["samples_1"] == [3.0, 5000.5, 4000.0, 6000.0]
    status = ["too_few_samples", "estimated", "contact_jump", "estimated"]
    expected = {
        "rolling_radius_sum_mm": [None, -800.0, None, 1800.0],
        "rolling_radius_difference_mm": [None, -2.0, None, 4.5],
        "contact_angle_sum_rad": [None, -0.1, None, 0.225],
        "contact_angle_difference_rad": [None, -0.02, None, 0.045],
    }
    for name, values in expected.items():
        assert bins[name]["value"] == pytest.approx(values)
        assert bins[name]["std"] == pytest.approx([value if value is None else abs(value) / 100 for value in values])
        assert bins[name]["status"] == status


def test_numbers_come_with_their_uncertainty_and_unknown_ones_with_their_reason(client: httpx.Client) -> None:
    geometry = get(client, "/v1/wheelsets/WS-000/geometry")
    assert geometry["equivalent_conicity_1"] == {
        "value": 0.25,
        "std": 0.01,
        "interval_95": [0.23, 0.275],
        "n_windows": 7.5,
        "status": "estimated",
        "reason": None,
        "reason_code": None,
    }
    assert geometry["equivalent_conicity_amplitude_mm"] == 2.0
    assert geometry["nonlinearity_parameter_per_mm"] == {
        "value": None,
        "std": None,
        "interval_95": None,
        "n_windows": 0.0,
        "status": "unestimated",
        "reason": "4 mm is not covered",
        "reason_code": "amplitude_not_covered",
    }
    assert geometry["zero_crossing_mm"]["value"] == -0.25
    assert geometry["zero_crossing_mm"]["interval_95"] == pytest.approx([-20.25, 24.75])
    centre = {"displacement_mm": 0.125, "rolling_line_std_mm": 0.25, "origin": "mean_running_position"}
    assert geometry["centre"] == centre
    by_amplitude = geometry["conicity_by_amplitude"]
    assert [one["amplitude_mm"] for one in by_amplitude] == [1.0, 2.0, 3.0]
    assert [one["equivalent_conicity_1"]["value"] for one in by_amplitude] == [0.125, 0.25, None]
    assert geometry["provenance"]["code_version"] == "0.1.0+test"
    assert geometry["provenance"]["track_versions"] == {"S-1": [1]}


def test_a_trend_has_its_points_its_slope_and_its_forecast(client: httpx.Client) -> None:
    trend = get(client, "/v1/wheelsets/WS-000/trend")
    assert trend["points"]["value_1"] == [0.125, 0.15, 0.25]
    assert trend["points"]["std_1"] == [0.01, 0.011, None]
    assert trend["points"]["measured_at"][0] == "2025-06-15T15:06:40Z"
    assert trend["slope_1_per_1000_km"]["value"] == 0.02
    assert trend["slope_1_per_year"]["reason"] == "dates too close"
    assert trend["limit_1"] == 0.4
    assert trend["distance_to_limit_km"]["p10"] == 8000.0
    assert trend["distance_to_limit_km"]["p90"] is None
    assert "horizon" in trend["distance_to_limit_km"]["reason"]
    assert trend["date_of_limit"]["p10"] == "2025-09-23T15:06:40Z"


@pytest.mark.parametrize("when", [{}, {"as_of": "2025-07-25T15:06:40.123456789Z"}])
def test_geometry_and_trend_have_one_current_conicity(client: httpx.Client, when: dict[str, str]) -> None:
    geometry = get(client, "/v1/wheelsets/WS-000/geometry", **when)
    trend = get(client, "/v1/wheelsets/WS-000/trend", **when)
    assert geometry["equivalent_conicity_amplitude_mm"] == 2.0
    assert trend["current_1"] == geometry["equivalent_conicity_at_3_mm_1"]
    assert trend["current_1"]["reason_code"] == "amplitude_extrapolated"
    assert trend["current_mileage_km"] == geometry["mileage_km"] == 9500.5


def test_an_extrapolated_current_conicity_is_one_number_too() -> None:
    known = tuple(api_fleet.estimate(value) for value in (0.3, 0.3, 0.29))
    covered = replace(api_fleet.geometry(0.29), amplitude=np.array([2.0, 2.25, 2.75]) * 1e-3, conicity=known)
    record = replace(api_fleet.geometry_record(5, 0.29), geometry=replace(covered, reported_amplitude=2.75e-3))
    shown = geometry_schema.geometry(record).equivalent_conicity_at_3_mm_1
    assert shown.reason_code == "amplitude_extrapolated"
    assert shown.std is not None
    assert shown.std > 0.01
    of_trend = api_fleet.trend_record(5, 0.25)
    assert trend_schema.trend(of_trend, record, None).current_1 == shown
    fleet = FleetWear((), 4, (BeyondReached(2.75e-3, 0.01, 0.002),))
    by_siblings = geometry_schema.geometry(record, fleet=fleet).equivalent_conicity_at_3_mm_1
    assert by_siblings.value == pytest.approx((shown.value or 0.0) + 0.01)
    assert by_siblings.std is not None
    assert by_siblings.std < shown.std
    with_fleet = replace(of_trend, trend=replace(of_trend.trend, fleet=fleet))
    assert trend_schema.trend(with_fleet, record, None).current_1 == by_siblings
    assert geometry_schema.interval(record, fleet).equivalent_conicity_at_3_mm_1 == by_siblings
    for other in (None, replace(record, baseline=1)):
        unknown = trend_schema.trend(of_trend, other, None)
        assert (unknown.current_1.value, unknown.current_mileage_km) == (None, None)
        assert unknown.current_1.reason_code == "no_geometry_since_reprofiling"


def test_a_geometry_that_contradicts_its_class_shows_what_does_not_fit_and_no_number() -> None:
    why = Reason(ReasonCode.YAW_SPRING_DIFFERS, "a moment of +90%")
    record = replace(api_fleet.geometry_record(5, 0.29), geometry=api_fleet.geometry(0.29).mismatched(why))
    shown = geometry_schema.geometry(record).model_dump(mode="json")
    assert (shown["status"], shown["reason_code"], shown["reason"]) == ("model_mismatch", why.code.value, why.text)
    numbers = [shown["equivalent_conicity_1"], shown["equivalent_conicity_at_3_mm_1"]]
    numbers += [one["equivalent_conicity_1"] for one in shown["conicity_by_amplitude"]]
    assert len(numbers) > 3
    for one in numbers:
        assert (one["value"], one["std"], one["status"]) == (None, None, "model_mismatch")
        assert one["reason_code"] == "yaw_spring_differs"


def test_a_vehicle_leads_to_what_its_passes_show_of_its_suspension(client: httpx.Client) -> None:
    vehicle = get(client, "/v1/vehicles/V-0")
    suspension = get(client, vehicle["links"]["suspension"])
    assert [one["stiffness_ratio_1"]["value"] for one in suspension["findings"]] == [1.0] * 5 + [0.5] * 3
    first = suspension["findings"][0]
    assert (first["section"], first["assumed_m"], first["measured_to"]) == ("S-1", 0.336, "2025-06-16T15:06:40Z")
    assert first["stiffness_ratio_1"]["std"] == 0.03125
    assert first["stiffness_ratio_1"]["interval_95"] == pytest.approx([1.0 - 0.06125, 1.0 + 0.06125], abs=1e-4)
    change = suspension["change"]
    assert change["change_1"]["value"] == pytest.approx(-0.5, abs=0.05)
    assert change["change_1"]["interval_95"][1] < -0.2
    assert (change["past_findings"], change["recent_findings"], change["other_vehicles"]) == (5, 3, 1)
    nothing = get(client, "/v1/vehicles/V-2/suspension")
    assert (nothing["findings"], nothing["change"]) == ([], None)
    assert client.get("/v1/vehicles/V-9/suspension").status_code == 404


@pytest.mark.parametrize("resource", ["geometry", "trend"])
def test_as_of_gives_what_was_recorded_then(client: httpx.Client, resource: str) -> None:
    path = f"/v1/wheelsets/WS-000/{resource}"
    latest = client.get(path)
    link = latest.json()["links"]["as_recorded"]
    assert client.get(link).content == latest.content
    earlier = get(client, path, as_of="2025-07-25T15:06:40.123456789Z")
    key = "equivalent_conicity_1" if resource == "geometry" else "fitted_1"
    assert earlier[key]["value"] == 0.1875
    before = get(client, path, as_of="2025-07-25T15:06:40.123456788Z")
    assert (before["status"], before["reason_code"], before[key]["value"]) == ("unestimated", "no_geometry", None)
    assert "until 2025-07-25T15:06:40.123456788Z" in before["reason"]
    assert (before["unestimated_because"], before["provenance"], before["recorded_at"]) == (None, None, None)
    assert client.get(path, params={"as_of": "2200-01-01T00:00:00Z"}).status_code == 422


def test_a_trend_of_a_former_profile_is_left_out_now_as_then(service: Service) -> None:
    path = "/v1/wheelsets/WS-000/trend"
    latest = service.client.get(path).json()
    with service.storage.write() as unit:
        record = unit.geometries.current("WS-000")
        assert record is not None
        later = {"recorded_ns": record.recorded_ns + 1, "to_ns": record.to_ns + 1}
        put_geometry(unit, replace(record, baseline=latest["baseline"] + 1, **later))
    now = service.client.get(path).json()
    assert (now["fitted_1"]["value"], now["points"]["value_1"]) == (None, [])
    then = get(service.client, path, as_of=get(service.client, "/v1/wheelsets/WS-000/geometry")["recorded_at"])
    assert then["baseline"] == latest["baseline"] + 1
    assert (then["fitted_1"]["value"], then["points"]["value_1"]) == (None, [])


@pytest.mark.parametrize("resource", ["geometry", "trend"])
def test_what_was_purged_is_gone_not_unknown(service: Service, resource: str) -> None:
    path, before_ns = f"/v1/wheelsets/WS-000/{resource}", 1_500_000_000 * 10**9
    with service.storage.write() as unit:
        record_purge(unit.connection, Purged(Kept.SUPERSEDED_ESTIMATES, 1), before_ns, before_ns)
    answer = service.client.get(path, params={"as_of": "2017-07-14T02:39:59Z"})
    assert (answer.status_code, answer.json()["type"]) == (410, "urn:treadwatch:problem:history-purged")
    assert "2017-07-14T02:40:00Z" in answer.json()["detail"]
    kept = service.client.get(path, params={"as_of": "2017-07-14T02:40:00Z"})
    assert (kept.status_code, kept.json()["status"]) == (200, "unestimated")
    assert service.client.get(path).status_code == 200


def test_windows_are_half_open_ranges_of_the_vehicles_clock(client: httpx.Client) -> None:
    everything = get(client, "/v1/wheelsets/WS-000/windows")["items"]
    assert len(everything) == api_fleet.WINDOWS
    assert all(first["measured_to"] == second["measured_from"] for first, second in pairwise(everything))
    quality = everything[3]["quality"]
    assert quality["invalid_1"] == 0.02
    assert (quality["speed_min_km_h"], quality["speed_max_km_h"]) == pytest.approx((61.2, 64.8))  # 17 and 18 m/s
    bounds = {"from": everything[3]["measured_from"], "to": everything[7]["measured_from"]}
    assert get(client, "/v1/wheelsets/WS-000/windows", **bounds)["items"] == everything[3:7]
    page = get(client, "/v1/wheelsets/WS-000/windows", **bounds, limit=3)
    rest = get(client, page["next"])
    assert page["items"] + rest["items"] == everything[3:7]
    assert rest["next"] is None


def test_a_track_section_has_its_alignment(client: httpx.Client) -> None:
    section = get(client, "/v1/track-sections/S-1")
    assert (section["nominal_gauge_mm"], section["tonnage_mgt_per_year"]) == (1435.0, None)
    alignment = get(client, section["links"]["alignment"])
    assert alignment["alignment_mm"] == [1.5, -2.0, 0.25, 0.0]
    assert alignment["position_m"] == [0.0, 0.5, 1.0, 1.5]
    assert get(client, alignment["links"]["self"]) == alignment
    assert client.get("/v1/track-sections/S-1/alignment?version=9").status_code == 404
    assert client.get("/v1/track-sections/S-2/alignment").status_code == 404


def test_an_alignment_of_the_fleet_says_how_it_was_found_and_what_it_leaves_open(client: httpx.Client) -> None:
    section = get(client, "/v1/track-sections/S-3")
    alignment = get(client, section["links"]["alignment"])
    assert (alignment["version"], alignment["same_since_version"], alignment["source"]) == (3, 1, "fleet")
    assert (alignment["cut_off_m"], alignment["scale_std_1"], alignment["gauge_known"]) == (60.0, 0.0125, False)
    assert alignment["recorded_at"] == "2025-07-25T15:06:40.123456792Z"
    report = alignment["report"]
    assert report == get(client, section["links"]["alignment_report"])
    assert report["evidence"] == ["fleet version 2"]
    assert report["residual_rms_mm"] == pytest.approx(0.1)
    assert report["moved_m"] is None
    assert report["refused_windows"] == {"the sensor reports a fault": 2}
    used, stranger = report["journeys"]
    assert (used["offset_m"], used["scale_1"], used["residual_rms_mm"], used["reason"]) == (-12.5, 5e-4, 0.125, None)
    assert (stranger["used"], stranger["reason"]) == (False, "agrees with no other")
    versions = get(client, section["links"]["alignments"])["items"]
    assert [one["version"] for one in versions] == [1, 2, 3]
    assert versions[2]["alignment_std_mm"] == 0.5
    assert get(client, versions[0]["links"]["self"])["report"] is None


def test_a_section_without_an_estimate_states_why(client: httpx.Client) -> None:
    assert client.get("/v1/track-sections/S-2/alignment").status_code == 404
    report = get(client, "/v1/track-sections/S-2/alignment-report")
    assert (report["status"], report["version"]) == ("unestimated", None)
    assert report["reason"] == "the passes are too alike"
    assert client.get("/v1/track-sections/S-1/alignment-report").status_code == 404


def test_a_geometry_leads_to_the_alignment_it_was_estimated_with(client: httpx.Client) -> None:
    links = get(client, "/v1/wheelsets/WS-000/geometry")["links"]
    assert get(client, links["alignment:S-1"])["version"] == 1


def test_measured_profiles_are_listed_under_the_wheelset(client: httpx.Client) -> None:
    links = get(client, "/v1/wheelsets/WS-000")["links"]
    found = get(client, links["measured_profiles"])["items"]
    assert [one["measured_at"][:10] for one in found] == ["2025-06-20", "2025-06-24", "2025-06-27"]
    assert {name: found[0][name] for name in ("wheelset", "mileage_km", "left", "right", "std_mm")} == {
        "wheelset": "WS-000", "mileage_km": 5000.5, "left": "left", "right": "=right", "std_mm": 0.125,
    }  # fmt: skip
    assert get(client, "/v1/wheelsets/WS-001/measured-profiles")["items"] == []


def test_mountings_and_vehicles_are_found_by_what_runs_where(client: httpx.Client) -> None:
    mounted = get(client, "/v1/wheelsets", vehicle="V-1")["items"]
    assert [one["serial"] for one in mounted] == ["WS-004", "WS-005", "WS-006", "WS-007"]
    assert get(client, "/v1/vehicles/V-1")["axle_offsets_m"] == [0.0, 2.5, 17.0, 19.5]
    assert get(client, "/v1/wheelsets/WS-004/mountings")["items"][0]["axle"] == 1
    assert get(client, "/v1/wheelsets", fleet="=beta", limit=1000)["items"][0]["serial"] == "WS-001"
    assert get(client, "/v1/fleets/%3Dbeta")["name"] == "=1+1"


@pytest.mark.parametrize(
    "path",
    [
        "/v1/wheelsets/WS-999",
        "/v1/wheelsets/WS-999/geometry",
        "/v1/wheelsets/WS-999/trend",
        "/v1/wheelsets/WS-999/windows",
        "/v1/wheelsets/WS-999/mountings",
        "/v1/wheelsets/WS-999/reprofilings",
        "/v1/wheelsets/WS-999/measured-profiles",
        "/v1/fleets/none",
        "/v1/vehicles/none",
        "/v1/alerts/999999",
        "/v1/alerts/999999/events",
        "/v1/jobs/none",
        "/v1/jobs/none/runs",
        "/v1/job-runs/999999",
        "/v1/track-sections/none",
        "/v1/nothing",
    ],
)
def test_what_does_not_exist_is_a_problem_that_names_it(client: httpx.Client, path: str) -> None:
    response = client.get(path)
    assert response.status_code == 404
    assert response.headers["content-type"] == "application/problem+json"
    problem = response.json()
    assert problem["type"] == "urn:treadwatch:problem:not-found"
    assert problem["status"] == 404
    assert problem["instance"] == path
    if not path.endswith("nothing"):
        assert path.split("/")[3] in problem["detail"]


def test_health_readiness_and_measures(service: Service) -> None:
    client = service.client
    assert get(client, "/healthz") == {"status": "ok"}
    assert get(client, "/readyz") == {"status": "ok"}
    client.get("/v1/wheelsets/WS-000")
    measures = client.get("/metrics")
    assert measures.headers["content-type"].startswith("text/plain")
    lines = dict(line.rsplit(" ", 1) for line in measures.text.splitlines() if not line.startswith("#"))
    assert lines["treadwatch_database_up"] == "1.0"
    with service.storage.read() as unit:
        counts = unit.windows.counts()
    for state in ("pending", "estimated", "refused"):
        assert float(lines[f'treadwatch_windows{{state="{state}"}}']) == counts.get(state, 0)
    assert float(lines['treadwatch_alerts_open{fleet="alpha",kind="no_data",severity="warning"}']) >= 1
    key = 'treadwatch_http_requests_total{method="GET",route="/v1/wheelsets/{serial}",status="200"}'
    assert float(lines[key]) >= 1


def test_an_error_of_the_storage_reveals_nothing_of_the_machine() -> None:
    from api.problems import from_error  # noqa: PLC0415 - only here
    from estimation.errors import StorageError  # noqa: PLC0415 - the same

    problem = from_error(StorageError("could not open /srv/secret/treadwatch.sqlite"))
    assert (problem.status, problem.kind) == (503, "not-ready")
    assert "/srv" not in problem.detail
    assert from_error(ValueError("SELECT password")).detail == "the failure has been logged"
    assert from_error(ParameterError("is wrong", field="until")).errors[0].pointer == "#/until"


def test_a_section_and_a_wheelset_lead_to_what_belongs_to_rails_and_to_wheels(client: httpx.Client) -> None:
    section = get(client, "/v1/track-sections/S-1/rails")
    assert (section["limit_1"], section["limit_exceeded"], section["limit_amplitude_mm"]) == (0.05, True, 1.0)
    (period,) = section["periods"]
    assert (period["reference"], period["n_wheelsets"]) == ("known_rails", 4)
    near, far = period["by_amplitude"]
    assert near["excess_1"]["interval_95"] == [0.0375, 0.0875]
    assert far["rail_part_1"]["reason_code"] == "amplitude_not_covered"
    assert (section["trend"]["n_periods"], section["trend_reason"], section["trend_reason_code"]) == (3, None, None)
    wheels = get(client, f"/v1/wheelsets/{api_fleet.WHEELSETS[0]}/rails")
    assert wheels["reason_code"] == "measured_wheels_differ"
    methods = {one["method"]: one["equivalent_conicity_1"] for one in wheels["by_amplitude"][0]["conicities"]}
    assert list(methods) == ["wheel_and_rail_apart", "geometry"]
    assert methods["wheel_and_rail_apart"]["value"] == 0.0625
    geometry = get(client, wheels["links"]["geometry"])
    amplitudes = {one["amplitude_mm"]: one["equivalent_conicity_1"] for one in geometry["conicity_by_amplitude"]}
    for row in wheels["by_amplitude"]:
        (beside,) = (one["equivalent_conicity_1"] for one in row["conicities"] if one["method"] == "geometry")
        assert beside["value"] == amplitudes.get(row["amplitude_mm"], {"value": None})["value"]
    assert get(client, wheels["links"]["rails:S-1"]) == section
    for unknown in ("/v1/track-sections/S-2/rails", "/v1/track-sections/S-9/rails", "/v1/wheelsets/WS-9999/rails"):
        assert client.get(unknown).status_code == 404
