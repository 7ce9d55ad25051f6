"""Webhooks over REST, from making one to what its receiver verifies; delivered by the running service itself."""

from __future__ import annotations

import json
import logging
import re
import threading
import time
from collections.abc import Iterator
from contextlib import nullcontext
from dataclasses import dataclass, field
from pathlib import Path

import api_fleet
import httpx
import pytest
from guarded_service import Guarded, guarded_service, settings_in
from one_database import in_turn
from populated_service import new_database
from webhook_receiver import Answer, Received, Receiver, receiving

from api.logs import Redactor
from api.serving import open_services
from api.webhooks.cloud_events import signature
from api.webhooks.delivering import deliver
from api.webhooks.sending import Sender, Targets, networks_of

DOC = Path(__file__).parents[2] / "docs" / "webhooks.md"
LOOPBACK = "127.0.0.0/8"
SECRET = re.compile(r"whsec_[A-Za-z0-9+/=]{20,}")


@dataclass
class Administered:
    """A service that two processes would deliver for, a receiver, and everything that the service has answered."""

    service: Guarded
    receiver: Receiver
    answers: list[tuple[str, str]] = field(default_factory=list)
    secrets: list[str] = field(default_factory=list)
    all_fleets: dict[str, str] = field(default_factory=dict)

    def ask(self, method: str, path: str, key: dict[str, str] | None = None, **more: object) -> httpx.Response:
        """Ask, and keep the answer."""
        headers = self.all_fleets | (key or {}) | more.pop("headers", {})  # type: ignore[operator]
        response = self.service.client.request(method, path, headers=headers, **more)  # type: ignore[arg-type]
        self.answers.append((f"{method} {path}", response.text))
        return response

    def webhook(self, key: dict[str, str] | None = None, **fields: object) -> tuple[str, str]:
        """Make a webhook; return its path and its secret."""
        made = self.ask("POST", "/v1/webhooks", key, json={"url": self.receiver.url, **fields})
        assert made.status_code == 201, made.text
        self.answers.pop()
        self.secrets.append(made.json()["secret"])
        return made.headers["location"], made.json()["secret"]


@pytest.fixture(scope="module", params=in_turn)
def served(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory, postgres_server_url: str
) -> Iterator[Administered]:
    """Yield a service beside which another process would deliver as well."""
    folder = tmp_path_factory.mktemp("webhooks")
    with new_database(postgres_server_url) if request.param == "postgresql" else nullcontext() as url:
        given = {"database_url": url, "webhook_networks": LOOPBACK, "log_level": "error"}
        with guarded_service(folder, **given) as service, receiving() as receiver:
            beside = open_services(settings_in(folder, **given))
            stopping = threading.Event()
            second = threading.Thread(target=deliver, args=(beside, Sender(Targets(networks_of(LOOPBACK))), stopping))
            second.start()
            yield Administered(service, receiver, all_fleets=service.key("the operator"))
            stopping.set()
            second.join()
            beside.runner.close()
            beside.close()


@pytest.fixture(autouse=True)
def _well(served: Administered) -> Iterator[None]:
    """Let the receiver take everything, and leave no webhook to the next test."""
    served.receiver.answer = Answer(204)
    served.receiver.received.clear()
    yield
    for one in served.ask("GET", "/v1/webhooks").json()["items"]:
        served.ask("DELETE", one["links"]["self"])


def test_a_receiver_verifies_what_comes_with_the_lines_of_the_page(served: Administered) -> None:
    (lines,) = re.findall(r"```python\n(.*?)```", DOC.read_text(), re.DOTALL)
    assert len(lines.strip().splitlines()) <= 12
    page: dict[str, object] = {}
    exec(lines, page)  # noqa: S102 - what the page tells its readers to run
    verified = page["verified"]
    assert callable(verified)
    path, secret = served.webhook(description="work orders")
    cursor = served.ask("GET", "/v1/alerts/feed?after=latest").json()["next_cursor"]
    served.service.alert()
    (came,) = served.receiver.wait_for(1)[:1]
    assert verified(secret, came.headers, came.body)
    assert not verified(secret, came.headers, came.body + b" ")
    assert not verified(secret, {**came.headers, "webhook-id": "other"}, came.body)
    assert not verified(secret, {**came.headers, "webhook-timestamp": "1774860123"}, came.body)
    assert not verified("whsec_" + "A" * 43 + "=", came.headers, came.body)

    listed = served.ask("GET", "/v1/alerts/feed", params={"after": cursor}).json()["items"]
    served.receiver.wait_for(len(listed))
    assert [json.loads(one.body)["data"] for one in served.receiver.received] == listed
    behind = served.ask("GET", "/v1/alerts/feed", params={"after": came.headers["webhook-id"]}).json()["items"]
    assert behind == listed[1:]
    deliveries = _deliveries(served, path, len(listed))
    assert [one["event_id"] for one in deliveries] == [one.headers["webhook-id"] for one in served.receiver.received][
        ::-1
    ]
    assert {(one["state"], one["attempts"], one["status_code"]) for one in deliveries} == {("delivered", 1, 204)}


def _deliveries(served: Administered, path: str, count: int) -> list[dict[str, object]]:
    """Return the deliveries once there are so many, which are stored after they came."""
    until = time.monotonic() + 30.0
    while len(found := served.ask("GET", f"{path}/deliveries").json()["items"]) < count:
        assert time.monotonic() < until
        time.sleep(0.05)
    return list(found)


def test_a_trial_says_what_came_back(served: Administered) -> None:
    path, _ = served.webhook()
    served.ask("PATCH", path, headers={"If-Match": "*"}, json={"state": "paused"})
    trial = served.ask("POST", f"{path}/test").json()
    assert (trial["delivered"], trial["status_code"], trial["reason_code"]) == (True, 204, None)
    (came,) = served.receiver.received
    assert json.loads(came.body)["type"] == "treadwatch.webhook.test"
    assert came.headers["webhook-id"] == trial["event_id"]
    served.receiver.answer = Answer(302, {"Location": "http://127.0.0.1:1/"})
    trial = served.ask("POST", f"{path}/test").json()
    assert (trial["delivered"], trial["status_code"], trial["reason_code"]) == (False, 302, "redirect")
    assert served.ask("GET", f"{path}/deliveries").json()["items"] == []


def test_pages_of_deliveries_and_a_replay_in_order_under_the_same_ids(served: Administered) -> None:
    path, _ = served.webhook()
    cursor = served.ask("GET", "/v1/alerts/feed?after=latest").json()["next_cursor"]
    for _ in range(2):
        served.service.alert()
    count = len(served.ask("GET", "/v1/alerts/feed").json()["items"])
    began = _deliveries(served, path, len(served.ask("GET", f"/v1/alerts/feed?after={cursor}").json()["items"]))
    before = [one.headers["webhook-id"] for one in served.receiver.received]
    paged, link = [], f"{path}/deliveries?limit=1"
    while link:
        page = served.ask("GET", link).json()
        paged += [one["id"] for one in page["items"]]
        link = page["next"]
    assert paged == [one["id"] for one in began]
    assert paged == sorted(paged, reverse=True)
    assert len(paged) > 1

    served.receiver.received.clear()
    assert served.ask("POST", f"{path}/replay", json={"after": before[0]}).status_code == 200
    served.receiver.wait_for(len(before) - 1)
    assert [one.headers["webhook-id"] for one in served.receiver.received] == before[1:]
    _deliveries(served, path, 2 * len(before) - 1)
    served.receiver.received.clear()
    assert served.ask("POST", f"{path}/replay", json={"from": "2000-01-01T00:00:00Z"}).status_code == 200
    served.receiver.wait_for(count)
    assert [one.headers["webhook-id"] for one in served.receiver.received][-len(before) :] == before
    for body in ({}, {"after": "latest", "from": "2000-01-01T00:00:00Z"}, {"from": "soon"}):
        assert served.ask("POST", f"{path}/replay", json=body).status_code == 422
    assert served.ask("POST", f"{path}/replay", json={"after": "nonsense"}).status_code == 400


def test_a_paused_webhook_goes_on_where_it_stood_and_another_filter_brings_nothing_old(served: Administered) -> None:
    path, _ = served.webhook(fleets=["beta"])
    served.service.alert()  # of alpha
    read = served.ask("GET", path)
    assert served.ask("PATCH", path, json={"state": "paused"}).status_code == 428
    etag = {"If-Match": read.headers["etag"]}
    paused = served.ask("PATCH", path, headers=etag, json={"state": "paused", "fleets": []})
    assert (paused.json()["state"], paused.json()["fleets"]) == ("paused", [])
    assert served.ask("PATCH", path, headers=etag, json={"state": "active"}).status_code == 412
    api_fleet.raised(served.service.storage, "WS-B", "identity", "beta")
    time.sleep(1.5)  # the worker looks once a second
    assert served.receiver.received == []
    active = served.ask("PATCH", path, headers={"If-Match": paused.headers["etag"]}, json={"state": "active"})
    assert active.status_code == 200
    (came, *_) = served.receiver.wait_for(1)
    assert json.loads(came.body)["data"]["alert"]["fleet"] == "beta"
    assert {json.loads(one.body)["data"]["alert"]["fleet"] for one in served.receiver.received} == {"beta"}


def test_a_rotated_secret_signs_beside_the_former_one_for_a_while(served: Administered) -> None:
    path, first = served.webhook()
    rotated = served.ask("POST", f"{path}/secret", json={"overlap_s": 3600})
    served.answers.pop()
    second = rotated.json()["secret"]
    served.secrets.append(second)
    assert rotated.headers["cache-control"] == "no-store"
    served.ask("POST", f"{path}/test")
    assert _signed_by(served.receiver.received[-1], [first, second]) == [second, first]
    last = served.ask("POST", f"{path}/secret", json={"overlap_s": 0}).json()["secret"]
    served.answers.pop()
    served.secrets.append(last)
    served.ask("POST", f"{path}/test")
    assert _signed_by(served.receiver.received[-1], [first, second, last]) == [last]
    assert len({first, second, last}) == 3


def _signed_by(came: Received, secrets: list[str]) -> list[str]:
    """Return which secret made which signature, in their order."""
    made = {
        signature(one, came.headers["webhook-id"], int(came.headers["webhook-timestamp"]), came.body): one
        for one in secrets
    }
    return [made[one] for one in came.headers["webhook-signature"].split(" ")]


def test_a_bound_key_makes_and_sees_webhooks_of_its_fleets_alone(served: Administered) -> None:
    beta, reader = served.service.key("beta", fleet="beta"), served.service.key(without="admin")
    whole, _ = served.webhook()
    own, _ = served.webhook(beta)
    assert served.ask("GET", own, beta).json()["bound_to"] == ["beta"]
    assert [one["links"]["self"] for one in served.ask("GET", "/v1/webhooks", beta).json()["items"]] == [own]
    for method, path, body in (
        ("GET", whole, None),
        ("GET", f"{whole}/deliveries", None),
        ("PATCH", whole, {}),
        ("DELETE", whole, None),
        ("POST", f"{whole}/test", None),
        ("POST", f"{whole}/replay", {"after": "latest"}),
        ("POST", f"{whole}/secret", {}),
    ):
        assert served.ask(method, path, beta, headers={"If-Match": "*"}, json=body).status_code == 404, path
        assert served.ask(method, path, reader, headers={"If-Match": "*"}, json=body).status_code == 403, path
    foreign = {"url": served.receiver.url, "fleets": ["alpha"]}
    assert served.ask("POST", "/v1/webhooks", beta, json=foreign).status_code == 404
    assert served.ask("PATCH", own, headers={"If-Match": "*"}, json={"fleets": ["alpha"]}).status_code == 404

    served.ask("PATCH", whole, headers={"If-Match": "*"}, json={"state": "paused"})
    served.service.alert()
    api_fleet.raised(served.service.storage, "WS-B", "model_mismatch", "beta")
    served.receiver.wait_for(1)
    _deliveries(served, own, 1)
    assert {json.loads(one.body)["data"]["alert"]["fleet"] for one in served.receiver.received} == {"beta"}
    event = served.receiver.received[0].headers["webhook-id"]
    assert served.ask("GET", "/v1/alerts/feed", beta, params={"after": event}).status_code == 200
    assert served.ask("POST", f"{own}/replay", beta, json={"after": event}).status_code == 200


@pytest.mark.parametrize(
    ("fields", "pointer"),
    [
        ({"url": "http://10.0.0.1/"}, "#/url"),
        ({"url": "https://169.254.169.254/latest/meta-data"}, "#/url"),
        ({"url": "https://user:word@127.0.0.1/"}, "#/url"),
        ({"url": "https://127.0.0.1:22/"}, "#/url"),
        ({"url": "https://receiver.invalid/"}, "#/url"),
        ({"url": "ftp://127.0.0.1/"}, "#/url"),
        ({"kinds": ["conicity"]}, "#/kinds/0"),
        ({"severities": ["deadly"]}, "#/severities/0"),
        ({"secret": "whsec_bXkgb3du"}, "#/secret"),
    ],
)
def test_what_no_webhook_may_be(served: Administered, fields: dict[str, object], pointer: str) -> None:
    refused = served.ask("POST", "/v1/webhooks", json={"url": served.receiver.url, **fields})
    assert refused.status_code == 422, refused.text
    assert [one["pointer"] for one in refused.json()["errors"]] == [pointer]
    assert served.ask("GET", "/v1/webhooks").json()["items"] == []


def test_measures_audit_and_no_secret_anywhere(served: Administered, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.DEBUG)
    served.receiver.answer = Answer(500)
    path, secret = served.webhook()
    served.service.alert()
    served.receiver.wait_for(1)
    (waits,) = _deliveries(served, path, 1)
    assert (waits["state"], waits["reason_code"], waits["status_code"]) == ("waiting", "status", 500)
    number = path.rsplit("/", maxsplit=1)[-1]
    measures = served.ask("GET", "/metrics").text
    assert f'treadwatch_webhook_attempts_total{{outcome="failed",webhook="{number}"}} 1.0' in measures
    assert 'treadwatch_webhooks{state="active"} 1.0' in measures
    (oldest,) = re.findall(rf'oldest_undelivered_timestamp_seconds{{webhook="{number}"}} (\S+)', measures)
    assert float(oldest) == api_fleet.RECORDED / 1e9
    served.receiver.answer = Answer(410)
    served.ask("PATCH", path, headers={"If-Match": "*"}, json={})
    served.receiver.wait_for(2)
    until = time.monotonic() + 30.0
    while (found := served.ask("GET", path).json())["state"] != "disabled":
        assert time.monotonic() < until
    assert found["disabled_reason"] == "gone"
    assert 'treadwatch_webhooks{state="disabled"} 1.0' in served.ask("GET", "/metrics").text
    served.ask("POST", f"{path}/secret", json={})
    served.answers.pop()
    served.ask("DELETE", path)
    done = [(one["method"], one["object"], one["owner"]) for one in served.ask("GET", "/v1/audit").json()["items"]]
    for method, what in (("POST", path), ("PATCH", path), ("POST", f"{path}/secret"), ("DELETE", path)):
        assert (method, what, "the operator") in done
    assert len(served.answers) > 20
    assert not [asked for asked, text in served.answers if any(one in text for one in served.secrets)]
    assert not [asked for asked, text in served.answers if SECRET.search(text)]
    assert "is disabled (gone)" in caplog.text
    assert not SECRET.search(caplog.text)
    assert Redactor()(f"failed with {secret}, no more") == "failed with whsec_***, no more"
