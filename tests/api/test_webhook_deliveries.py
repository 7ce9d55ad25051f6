"""The feed handed to real receivers on loopback, with a clock that the test moves."""

from __future__ import annotations

import json
import logging
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import pytest
from service_process import service_process
from webhook_deployment import DAY_S, SECOND, Deployment, MovedClock, kinds_of
from webhook_receiver import Answer, Receiver, receiving

from api.answers import payload_of
from api.feed import pages
from api.feed.pages import FeedFilter
from api.schemas import alerts
from estimation.errors import StorageError
from estimation.values.registry import FleetRecord, WheelsetRecord
from fleet_db.locks import sending_alone
from fleet_db.migrate import upgrade
from fleet_db.records import DeliveryState, DisabledReason, Failure, WebhookState
from fleet_db.session import database_engine
from fleet_db.storage import SqlStorage, SqlUnitOfWork

CLIENT_LOGS = {"httpx", "httpcore.http11", "httpcore.connection"}
"""They name URLs; ``api.logs`` silences them, as the test with a real service shows."""


def test_a_receiver_that_fails_for_a_day_misses_nothing_and_gets_it_in_order(
    deployment: Deployment, receiver: Receiver
) -> None:
    number = deployment.webhook(receiver.url)
    began = deployment.clock.now
    receiver.answer = Answer(500)
    for kind in ("conicity_limit", "identity", "model_mismatch"):
        deployment.raise_alert(kind)
    deployment.deliver()
    while deployment.clock.now < began + DAY_S * SECOND:
        (waits,) = deployment.sent(number)
        assert waits.state is DeliveryState.WAITING
        assert waits.next_ns is not None
        deployment.deliver((waits.next_ns - deployment.clock.now) / SECOND - 1.0)
        assert deployment.sent(number)[0].attempts == waits.attempts, "it was sent before its time"
        deployment.deliver(1.0)
    (waits,) = deployment.sent(number)
    assert (waits.attempts, waits.status_code, waits.failure) == (len(receiver.received), 500, Failure.STATUS)
    assert len(receiver.received) > 9
    assert len(set(receiver.ids())) == 1, "another id at another attempt"
    assert deployment.state(number).state is WebhookState.ACTIVE
    assert deployment.state(number).position == 0

    receiver.received.clear()
    receiver.answer = Answer(200)
    deployment.deliver(9 * 3600.0)
    assert kinds_of(receiver) == ["conicity_limit", "identity", "model_mismatch"]
    assert [one.state for one in deployment.sent(number)] == [DeliveryState.DELIVERED] * 3
    receiver.received.clear()
    deployment.deliver(DAY_S)
    assert receiver.received == []


def test_what_is_never_taken_disables_the_webhook_and_is_sent_when_it_is_enabled_again(
    deployment: Deployment, receiver: Receiver, caplog: pytest.LogCaptureFixture
) -> None:
    receiver.answer = Answer(503, {"Retry-After": "21600"})
    number = deployment.webhook(f"{receiver.url}?token=geheim")
    deployment.raise_alert("conicity_limit")
    deployment.raise_alert("identity")
    with caplog.at_level(logging.DEBUG):
        for _ in range(20):
            deployment.deliver(8.1 * 3600)
    found = deployment.state(number)
    assert (found.state, found.disabled_reason) == (WebhookState.DISABLED, DisabledReason.FAILING)
    assert found.since_ns == deployment.sent(number)[0].last_ns
    assert [one.state for one in deployment.sent(number)] == [DeliveryState.FAILED]
    attempts = deployment.sent(number)[0].attempts
    assert attempts == len(receiver.received) == 10
    assert "is disabled (failing) after 10 attempts" in caplog.text
    assert "geheim" not in "".join(one.getMessage() for one in caplog.records if one.name not in CLIENT_LOGS)

    receiver.answer = Answer(204)
    receiver.received.clear()
    deployment.change(number, state=WebhookState.ACTIVE, disabled_reason=None)
    deployment.deliver()
    assert kinds_of(receiver) == ["conicity_limit", "identity"]


def test_410_disables_at_once(embedded: Deployment, receiver: Receiver) -> None:
    receiver.answer = Answer(410)
    number = embedded.webhook(receiver.url)
    embedded.raise_alert("conicity_limit")
    embedded.deliver()
    embedded.deliver(DAY_S)
    found = embedded.state(number)
    assert (found.state, found.disabled_reason, found.position) == (WebhookState.DISABLED, DisabledReason.GONE, 0)
    assert len(receiver.received) == 1


@dataclass(frozen=True)
class Forgetful(SqlStorage):
    """A storage that is out of reach for whoever wants to write."""

    @contextmanager
    def write(self, *, fenced: bool = True) -> Iterator[SqlUnitOfWork]:  # noqa: ARG002 - as the real one
        raise StorageError("the database failed: gone")
        yield  # pragma: no cover


def test_what_was_sent_and_could_not_be_stored_is_sent_again_under_the_same_id(
    deployment: Deployment, receiver: Receiver, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("api.webhooks.delivering.AFTER_STORAGE_S", 0.0)
    number = deployment.webhook(receiver.url)
    deployment.raise_alert("conicity_limit")
    away = Forgetful(deployment.storage.engine, deployment.storage.data_dir)
    deployment.deliver(storage=away)
    assert len(receiver.received) == 1
    assert deployment.sent(number) == []
    deployment.deliver(1.0)
    assert len(receiver.received) == 2
    assert len(set(receiver.ids())) == 1
    assert receiver.received[0].body == receiver.received[1].body
    (sent,) = deployment.sent(number)
    assert (sent.state, deployment.state(number).position) == (DeliveryState.DELIVERED, sent.sequence)


@pytest.mark.slow
def test_a_service_that_is_killed_before_it_stores_sends_again(tmp_path: Path) -> None:
    """The receiver has the event when the process is killed; another one takes over, with the same id."""
    url = f"sqlite:///{tmp_path / 'data' / 'treadwatch.sqlite'}"
    upgrade(url)
    deployment = Deployment(SqlStorage(database_engine(url), tmp_path / "data"), MovedClock())
    with deployment.storage.write() as unit:
        unit.registry.add_fleet(FleetRecord("alpha", "alpha"))
        unit.registry.add_wheelset(WheelsetRecord("WS-A", "alpha", "P8", 0.46, None))
    killed: list[int] = []
    with service_process(tmp_path, WEBHOOK_NETWORKS="127.0.0.0/8", LOG_LEVEL="debug") as service:

        def kill() -> None:
            if not killed:
                killed.append(service.process.pid)
                service.process.kill()
                service.process.wait()

        with receiving(before=kill) as receiver:
            number = deployment.webhook(receiver.url)
            deployment.raise_alert("conicity_limit")
            receiver.wait_for(1)
            service.process.wait()
            assert deployment.sent(number) == []
            with sending_alone(deployment.storage.engine, "the next") as alone:
                assert alone is not None, "the lock outlived its process"
            deployment.deliver()
            assert len(receiver.received) == 2
            assert len(set(receiver.ids())) == 1
        assert "/hook" not in service.log
    deployment.storage.close()


def test_one_process_at_a_time_may_send(deployment: Deployment) -> None:
    engine = deployment.storage.engine
    with sending_alone(engine, "first") as first:
        assert first is not None
        assert first()
        with sending_alone(engine, "second") as second:
            assert second is None
        assert first()
    with sending_alone(engine, "third") as third:
        assert third is not None


def test_a_webhook_of_a_bound_key_carries_its_fleets_alone(deployment: Deployment, receiver: Receiver) -> None:
    bound = deployment.webhook(receiver.url, bound=frozenset({"beta"}))
    with receiving() as other:
        deployment.webhook(other.url, fleets=frozenset({"alpha"}), severities=frozenset({"critical"}))
        deployment.raise_alert("conicity_limit")
        deployment.raise_alert("conicity_limit", "WS-B", "beta")
        deployment.deliver()
        assert [json.loads(one.body)["data"]["alert"]["fleet"] for one in receiver.received] == ["beta"]
        assert [json.loads(one.body)["data"]["alert"]["fleet"] for one in other.received] in ([], ["alpha"])
    see = deployment.storage.seen_by
    for fleets, expected in (({"beta"}, [bound]), ({"alpha"}, []), ({"alpha", "beta"}, [bound])):
        with see(frozenset(fleets)).read() as unit:
            assert [one.webhook_id for one in unit.webhooks.page(None, None)] == expected
            assert len(unit.webhooks.deliveries(bound, None, 9)) == len(expected)
            assert unit.webhooks.secrets(bound, deployment.clock.now) == []


def test_a_replay_while_something_is_sent_is_not_undone_by_its_answer(deployment: Deployment) -> None:
    deployment.raise_alert("conicity_limit")

    def move_back() -> None:
        if len(receiver.received) == 1:
            deployment.change(number, position=0)

    with receiving(before=move_back) as receiver:
        number = deployment.webhook(receiver.url)
        deployment.raise_alert("identity")
        deployment.deliver()
        assert kinds_of(receiver) == ["identity", "conicity_limit", "identity"]
        assert receiver.ids()[0] == receiver.ids()[2]


def test_the_body_is_a_cloud_event_whose_data_is_the_event_of_the_feed(
    embedded: Deployment, receiver: Receiver
) -> None:
    embedded.webhook(receiver.url)
    embedded.raise_alert("conicity_limit")
    embedded.deliver()
    (received,) = receiver.received
    with embedded.storage.read() as unit:
        (event,) = unit.alerts.feed(0, 10)
        branch = unit.feed_branches.all()[0].identity
    sent = json.loads(received.body)
    assert received.body.endswith(b',"data":' + payload_of(alerts.event(event)) + b"}")
    assert {name: sent[name] for name in sent if name not in {"data", "id"}} == {
        "specversion": "1.0",
        "source": f"urn:treadwatch:feed:{branch}",
        "type": "treadwatch.alert.raised",
        "subject": f"/v1/alerts/{event.alert.alert_id}",
        "time": sent["data"]["recorded_at"],
        "datacontenttype": "application/json",
    }
    assert received.headers["content-type"] == "application/cloudevents+json"
    assert received.headers["webhook-id"] == sent["id"]


def test_an_event_keeps_its_id_when_the_database_is_restored(embedded: Deployment, receiver: Receiver) -> None:
    number = embedded.webhook(receiver.url)
    embedded.raise_alert("conicity_limit")
    embedded.deliver()
    with embedded.storage.write() as unit:
        unit.feed_branches.begin(embedded.clock.now)
    embedded.change(number, position=0)
    embedded.raise_alert("identity")
    embedded.deliver()
    assert receiver.ids()[0] == receiver.ids()[1] != receiver.ids()[2]
    whole = FeedFilter()
    with embedded.storage.read() as unit:
        for identity, expected in zip(receiver.ids()[1:], (["identity"], []), strict=True):
            last = pages.event_of(unit, whole, "/v1/alerts/feed", pages.cursor_of(whole, identity))
            assert last is not None
            assert [one.alert.kind for one in unit.alerts.feed(last.sequence, 9)] == expected
