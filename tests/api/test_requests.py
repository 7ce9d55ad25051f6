"""Which requests are valid, the form of the answers, and the form of a refusal."""

from __future__ import annotations

import csv
import io
import re
import socket
from typing import Any

import httpx
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from running_service import Service

from api.answers import csv_text
from api.contract import choose
from api.schemas.common import finite, finite_list
from api.times import from_rfc3339, times_to_rfc3339, to_rfc3339

TIME = re.compile(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d(\.\d+)?Z")


def problem(response: httpx.Response, status: int, kind: str) -> Any:  # noqa: ANN401 - JSON
    assert response.status_code == status, response.text
    assert response.headers["content-type"] == "application/problem+json"
    body = response.json()
    assert body["type"] == f"urn:treadwatch:problem:{kind}"
    assert body["status"] == status
    assert body["title"]
    assert body["instance"] == response.request.url.path
    return body


def test_an_unknown_or_repeated_parameter_is_422_and_named(client: httpx.Client) -> None:
    body = problem(client.get("/v1/alerts?flet=x&limit=3"), 422, "invalid-request")
    assert [(error["in"], error["pointer"]) for error in body["errors"]] == [("query", "#/flet")]
    body = problem(client.get("/v1/wheelsets/WS-000?a~b/c=1"), 422, "invalid-request")
    assert body["errors"][0]["pointer"] == "#/a~0b~1c"
    problem(client.get("/v1/alerts?fleet=a&fleet=b"), 422, "invalid-request")


@pytest.mark.parametrize("kind", ["wear", "CONICITY_LIMIT", ""])
def test_an_unknown_kind_of_alert_is_422(client: httpx.Client, kind: str) -> None:
    problem(client.get("/v1/alerts", params={"kind": kind}), 422, "invalid-request")


@pytest.mark.parametrize(
    "text",
    [
        "2026-01-31",
        "2026-01-31T12:00:00",
        "1769860800",
        "2026-02-30T00:00:00Z",
        "2026-01-31T25:00:00Z",
        "1600-01-01T00:00:00Z",
        "9999-12-31T23:59:59Z",
        "0001-01-01T00:00:00+23:59",
        "now",
        "",
        "٢٠٢٦-01-31T12:00:00Z",
    ],
)
def test_a_time_that_is_none_is_422(client: httpx.Client, text: str) -> None:
    body = problem(client.get("/v1/wheelsets/WS-000/geometry", params={"as_of": text}), 422, "invalid-request")
    assert body["errors"][0]["pointer"] == "#/as_of"


@settings(max_examples=300, derandomize=True)
@given(st.integers(-(2**63), 2**63 - 1))
def test_times_lose_nothing_on_their_way_out_and_in(t_ns: int) -> None:
    text = to_rfc3339(t_ns)
    assert TIME.fullmatch(text)
    assert from_rfc3339(text) == t_ns


@settings(max_examples=100, derandomize=True)
@given(st.lists(st.integers(-(2**63) + 1, 2**63 - 1) | st.integers(-10, 10).map(lambda s: s * 100_000_000)))
def test_many_times_are_written_as_one_is(times_ns: list[int]) -> None:
    assert times_to_rfc3339(np.array(times_ns, np.int64)) == [to_rfc3339(t_ns) for t_ns in times_ns]


@settings(max_examples=100, derandomize=True)
@given(st.lists(st.floats()), st.sampled_from([1.0, 1e3]))
def test_many_numbers_are_written_as_one_is(values: list[float], scale: float) -> None:
    assert finite_list(values, scale) == [finite(value, scale) for value in values]


def test_an_offset_is_understood() -> None:
    assert from_rfc3339("1970-01-01T02:00:00.5+02:00") == 500_000_000
    assert from_rfc3339("1969-12-31t23:59:59.999999999z") == -1


@pytest.mark.parametrize("path", ["/v1/wheelsets/WS-000/geometry", "/v1/wheelsets/WS-000/trend", "/v1/alerts"])
def test_every_time_is_utc_and_no_number_is_infinite(client: httpx.Client, path: str) -> None:
    text = client.get(path).text
    assert "NaN" not in text
    assert "Infinity" not in text

    def check(value: object, name: str = "") -> None:
        if isinstance(value, dict):
            for key, one in value.items():
                check(one, key)
        elif isinstance(value, list):
            for one in value:
                check(one, name)
        elif isinstance(value, str) and name.endswith(("_at", "_from", "_to", "_until")):
            assert TIME.fullmatch(value), name

    check(client.get(path).json())


@pytest.mark.parametrize("accept", ["text/html", "application/xml", "image/*", "application/json;q=0", "x/y, z/w"])
def test_an_unknown_media_type_is_406(client: httpx.Client, accept: str) -> None:
    for path in ("/v1/wheelsets", "/v1/wheelsets/WS-000", "/v1/wheelsets/WS-000/geometry"):
        problem(client.get(path, headers={"Accept": accept}), 406, "not-acceptable")
    problem(client.get("/v1/wheelsets/WS-000", headers={"Accept": "text/csv"}), 406, "not-acceptable")


@pytest.mark.parametrize(
    ("accept", "chosen"),
    [
        (None, "application/json"),
        ("", "application/json"),
        ("*/*", "application/json"),
        ("text/*", "text/csv"),
        ("application/json;q=0.5, text/csv", "text/csv"),
        ("text/csv;q=0.5, application/json", "application/json"),
        ("text/csv;q=0, */*", "application/json"),
        ("application/json;q=0, */*;q=0.1", "text/csv"),
        ("TEXT/CSV", "text/csv"),
        ("text/csv;q=high", None),
        ("text/html,application/xhtml+xml,*/*;q=0.8", "application/json"),
    ],
)
def test_the_best_liked_of_what_is_offered_is_chosen(accept: str | None, chosen: str | None) -> None:
    assert choose(accept, ["application/json", "text/csv"]) == chosen


def test_bin_tables_and_trends_come_as_csv_with_the_same_numbers(client: httpx.Client) -> None:
    accept = {"Accept": "text/csv"}
    table = client.get("/v1/wheelsets/WS-000/geometry", headers=accept)
    assert table.headers["content-type"] == "text/csv; charset=utf-8; header=present"
    assert table.headers["vary"] == "Accept"
    assert table.content.endswith(b"\r\n")
    rows = list(csv.DictReader(io.StringIO(table.text, newline="")))
    bins = client.get("/v1/wheelsets/WS-000/geometry").json()["bins"]
    assert [float(row["lower_mm"]) for row in rows] == bins["lower_mm"]
    for name in ("rolling_radius_sum_mm", "rolling_radius_difference_mm", "contact_angle_sum_rad"):
        stem, unit = name.rsplit("_", 1)
        for place, row in enumerate(rows):
            assert (float(row[name]) if row[name] else None) == bins[name]["value"][place]
            assert (float(row[f"{stem}_std_{unit}"]) if row[name] else None) == bins[name]["std"][place]
            assert row[f"{stem}_status"] == bins[name]["status"][place]
    trend = client.get("/v1/wheelsets/WS-000/trend", headers=accept)
    rows = list(csv.DictReader(io.StringIO(trend.text, newline="")))
    assert [row["value_1"] for row in rows] == ["0.125", "0.15", "0.25"]
    assert rows[2]["std_1"] == ""
    assert (
        client.get("/v1/wheelsets/WS-000/trend", headers=accept | {"If-None-Match": trend.headers["etag"]}).status_code
        == 304
    )


@settings(max_examples=200, derandomize=True)
@given(
    st.lists(
        st.text(st.characters(exclude_categories=["Cs"])) | st.floats(-1e9, 1e9) | st.none(), min_size=2, max_size=2
    )
)
def test_no_text_in_csv_begins_like_a_formula_and_numbers_stay_numbers(cells: list[Any]) -> None:
    text = csv_text(["first", "second"], [cells]).decode()
    _, row = csv.reader(io.StringIO(text, newline=""))
    for cell, read in zip(cells, row, strict=True):
        if isinstance(cell, float):
            assert float(read) == cell
        elif cell is None:
            assert read == ""
        else:
            assert not read.startswith(("=", "+", "-", "@", "\t", "\r"))
            assert read.removeprefix("'") == cell.removeprefix("'") if cell[:1] != "'" else read == cell


def test_reads_have_a_strong_etag_and_an_unchanged_resource_is_304(client: httpx.Client) -> None:
    for path in ("/v1/wheelsets/WS-001", "/v1/alerts/1", "/v1/wheelsets/WS-000/geometry", "/v1/track-sections/S-1"):
        first = client.get(path)
        tag = first.headers["etag"]
        assert re.fullmatch(r'"[0-9a-f]{32}"', tag)
        for held in (tag, f'"other", {tag}', f"W/{tag}", "*"):
            again = client.get(path, headers={"If-None-Match": held})
            assert again.status_code == 304, held
            assert again.content == b""
            assert again.headers["etag"] == tag
        assert client.get(path, headers={"If-None-Match": '"other"'}).content == first.content
    csv_tag = client.get("/v1/wheelsets/WS-000/geometry", headers={"Accept": "text/csv"}).headers["etag"]
    assert csv_tag != client.get("/v1/wheelsets/WS-000/geometry").headers["etag"]


def test_another_method_is_405_and_a_wrong_body_is_named(client: httpx.Client) -> None:
    response = client.delete("/v1/fleets")
    assert response.status_code == 405
    assert response.headers["content-type"] == "application/problem+json"
    assert response.headers["allow"] == "GET, HEAD"
    path = "/v1/alerts/1/acknowledge"
    problem(
        client.post(path, content=b"<by>me</by>", headers={"Content-Type": "text/xml"}), 415, "unsupported-media-type"
    )
    json_type = {"Content-Type": "application/json"}
    body = problem(client.post(path, content=b"{", headers=json_type), 422, "invalid-request")
    assert body["errors"][0]["in"] == "body"
    body = problem(client.post(path, json={"by": "", "nte": 1}), 422, "invalid-request")
    assert {error["pointer"] for error in body["errors"]} == {"#/by", "#/nte"}
    body = problem(client.post(path, json={"by": 7}), 422, "invalid-request")
    body = problem(client.post(path, json=[]), 422, "invalid-request")
    problem(client.post(path, content=b'{"by": "\\u0000"}', headers=json_type), 422, "invalid-request")
    problem(client.post(path, content=b'{"by": "\\ud800"}', headers=json_type), 422, "invalid-request")


def test_a_body_that_is_too_large_is_413_said_beforehand_or_not(client: httpx.Client) -> None:
    path = "/v1/alerts/1/acknowledge"
    huge = b'{"by": "' + b"x" * (1 << 20) + b'"}'
    json_type = {"Content-Type": "application/json"}
    problem(client.post(path, content=huge, headers=json_type), 413, "content-too-large")
    parts = (huge[start : start + 4096] for start in range(0, len(huge), 4096))
    problem(client.post(path, content=parts, headers=json_type), 413, "content-too-large")


def test_every_answer_carries_the_identity_of_its_request(client: httpx.Client) -> None:
    assert client.get("/v1/fleets", headers={"X-Request-Id": "mine-1"}).headers["x-request-id"] == "mine-1"
    made = client.get("/v1/nothing", headers={"X-Request-Id": "bad\tone"}).headers["x-request-id"]
    assert re.fullmatch("[0-9a-f]{32}", made)


@pytest.mark.parametrize(
    "path",
    [
        b"/v1/wheelsets/%00",
        b"/v1/wheelsets/%ff%fe",
        b"/v1/wheelsets/" + b"x" * 3000,
        b"/v1/alerts/99999999999999999999",
    ],
)
def test_paths_that_no_client_library_would_send_are_refused(service: Service, path: bytes) -> None:
    host, port = service.url.removeprefix("http://").split(":")
    with socket.create_connection((host, int(port)), timeout=10) as connection:
        connection.sendall(b"GET " + path + b" HTTP/1.1\r\nHost: test\r\nConnection: close\r\n\r\n")
        answer = b"".join(iter(lambda: connection.recv(65536), b""))
    assert re.match(rb"HTTP/1\.1 4\d\d ", answer)
    assert b"application/problem+json" in answer


@pytest.mark.parametrize(
    "path",
    [
        "/v1/wheelsets?fleet=nowhere",
        "/v1/wheelsets?vehicle=nowhere",
        "/v1/vehicles?fleet=nowhere",
        "/v1/alerts?fleet=nowhere",
        "/v1/alerts?wheelset=nowhere",
        "/v1/alerts?fleet_alert=999999",
        "/v1/quarantine?vehicle=nowhere",
    ],
)
def test_a_filter_that_names_nothing_is_404_and_named(client: httpx.Client, path: str) -> None:
    body = problem(client.get(path), 404, "not-found")
    assert path.rpartition("=")[2] in body["detail"]


def test_a_range_that_ends_before_it_begins_is_422(client: httpx.Client) -> None:
    path = "/v1/wheelsets/WS-000/windows?from=2026-02-01T00:00:00Z&to="
    body = problem(client.get(f"{path}2026-01-31T23:59:59.999999999Z"), 422, "invalid-request")
    assert body["errors"][0]["pointer"] == "#/from"
    assert client.get(f"{path}2026-02-01T00:00:00Z").json()["items"] == []
