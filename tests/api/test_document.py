"""What the OpenAPI document says beyond the routes: every property, header and problem, with examples."""

from __future__ import annotations

import json
from typing import Any

import httpx
import jsonschema_rs
import pytest
from running_service import Service

from api.access.guard import security_headers
from api.app import committed_document
from api.openapi.document import WORDS

DOCUMENT = json.loads(committed_document())
SCHEMAS = DOCUMENT["components"]["schemas"]
OPERATIONS = [(path, method, one) for path, item in DOCUMENT["paths"].items() for method, one in item.items()]
FROM_THE_SERVER = {"content-length", "content-type", "date", "server", "connection", "transfer-encoding"}
FROM_THE_SERVER |= set(map(str.lower, security_headers(https=False, shared=False)))  # for browsers, on every answer


def test_every_property_is_described_and_no_description_is_left_over() -> None:
    fields = {
        f"{name}.{field}": described
        for name, schema in SCHEMAS.items()
        for field, described in schema.get("properties", {}).items()
    }
    assert [field for field, described in fields.items() if "description" not in described] == []
    assert WORDS.keys() <= {field.rpartition(".")[2] for field in fields}


def test_every_problem_has_an_example_that_validates() -> None:
    validator = jsonschema_rs.validator_for(
        {"$ref": "#/components/schemas/Problem", "components": DOCUMENT["components"]}
    )
    checked = 0
    for path, method, operation in OPERATIONS:
        for status, response in operation["responses"].items():
            content = response.get("content", {}).get("application/problem+json")
            if content is None:
                assert status < "400", (path, method, status)
                continue
            example = content["example"]
            assert [str(error) for error in validator.iter_errors(example)] == []
            assert example["status"] == int(status)
            assert example["type"] != "about:blank", (path, method, status)
            checked += 1
    assert checked > 100


def test_if_match_is_required_where_it_is_taken() -> None:
    taken = [
        (path, method, parameter)
        for path, method, operation in OPERATIONS
        for parameter in operation.get("parameters", ())
        if parameter["name"] == "If-Match"
    ]
    assert len(taken) >= 4
    assert all(parameter["required"] for _, _, parameter in taken)
    for path, method, _ in taken:
        assert "428" in DOCUMENT["paths"][path][method]["responses"]


def _resolved(response: dict[str, Any]) -> set[str]:
    headers = DOCUMENT["components"]["headers"]
    for name, entry in response.get("headers", {}).items():
        assert headers[entry["$ref"].rsplit("/", maxsplit=1)[-1]]["description"], name
    return {name.lower() for name in response.get("headers", {})}


@pytest.mark.parametrize(
    ("method", "path", "template", "headers"),
    [
        ("GET", "/v1/wheelsets?limit=1", "/v1/wheelsets", {}),
        ("GET", "/v1/wheelsets/WS-000", "/v1/wheelsets/{serial}", {}),
        ("GET", "/v1/wheelsets/WS-000", "/v1/wheelsets/{serial}", {"If-None-Match": "*"}),
        ("GET", "/v1/wheelsets/none", "/v1/wheelsets/{serial}", {}),
        ("GET", "/v1/wheelsets/WS-000/geometry", "/v1/wheelsets/{serial}/geometry", {"Accept": "text/csv"}),
        ("GET", "/v1/alerts/feed", "/v1/alerts/feed", {}),
        ("GET", "/v1/fleets", "/v1/fleets", {"Accept": "image/png"}),
        ("POST", "/v1/alerts/1/acknowledge", "/v1/alerts/{alert_id}/acknowledge", {}),
        ("GET", "/healthz", "/healthz", {}),
    ],
)
def test_an_answer_has_no_header_that_the_document_lacks(
    client: httpx.Client, method: str, path: str, template: str, headers: dict[str, str]
) -> None:
    body = {"by": "me"} if method == "POST" else None
    response = client.request(method, path, headers=headers, json=body)
    described = _resolved(DOCUMENT["paths"][template][method.lower()]["responses"][str(response.status_code)])
    assert {name.lower() for name in response.headers} - FROM_THE_SERVER - described == set()
    assert "x-request-id" in response.headers


def _path(template: str) -> str:
    return template.replace("{alert_id}", "1").replace("{run_id}", "1").replace("{", "").replace("}", "")


def test_allow_names_every_method_of_a_path(service: Service) -> None:
    methods: dict[str, set[str]] = {}
    for path, method, _ in OPERATIONS:
        methods.setdefault(path, set()).add(method.upper())
    for path, known in methods.items():
        response = service.client.request("TRACE", _path(path))
        assert response.status_code == 405, path
        expected = {*known, "HEAD"} if "GET" in known else known
        assert set(response.headers["allow"].split(", ")) == expected, path
    assert set(service.client.put("/docs").headers["allow"].split(", ")) == {"GET", "HEAD"}


def test_head_is_get_without_the_body(client: httpx.Client) -> None:
    for path in ("/v1/wheelsets/WS-000", "/v1/alerts", "/healthz", "/metrics", "/docs", "/v1/wheelsets/none"):
        got, head = client.get(path), client.head(path)
        assert head.status_code == got.status_code, path
        assert head.content == b""
        assert head.headers["content-type"] == got.headers["content-type"]
        assert head.headers.get("etag") == got.headers.get("etag")
    tag = client.head("/v1/wheelsets/WS-000").headers["etag"]
    assert client.head("/v1/wheelsets/WS-000", headers={"If-None-Match": tag}).status_code == 304
    assert client.head("/v1/alerts/1/acknowledge").status_code == 405
