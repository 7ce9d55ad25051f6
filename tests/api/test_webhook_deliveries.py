"""The feed handed to real receivers on loopback, with a clock that the test moves."""

from __future__ import annotations

import asyncio
import datetime as dt
import json
import logging
import socket
import ssl
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import api_fleet
import pytest
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from service_process import service_process
from webhook_receiver import Answer, Receiver, receiving

from api.answers import payload_of
from api.feed import pages
from api.feed.pages import FeedFilter
from api.schemas import alerts
from api.webhooks.cloud_events import new_secret
from api.webhooks.delivering import Deliveries
from api.webhooks.sending import MOST_ANSWER_BYTES, Network, Sender, Targets, networks_of
from estimation.errors import StorageError
from estimation.values.registry import FleetRecord, WheelsetRecord
from fleet_db.locks import sending_alone
from fleet_db.migrate import upgrade
from fleet_db.records import Delivery, DeliveryState, DisabledReason, Failure, Webhook, WebhookState
from fleet_db.session import database_engine
from fleet_db.storage import SqlStorage, SqlUnitOfWork

LOOPBACK = networks_of("127.0.0.0/8, ::1/128")
SECOND, DAY_S = 1_000_000_000, 86_400
NO_JITTER = 0.5
CLIENT_LOGS = {"httpx", "httpcore.http11", "httpcore.connection"}
"""They name URLs; ``api.logs`` silences them, as the test with a real service shows."""


@dataclass
class MovedClock:
    """A clock that the test moves."""

    now: int = 1_774_860_123 * SECOND

    def now_ns(self) -> int:
        return self.now


@cache
def _sender(networks: tuple[Network, ...], timeout_s: float) -> Sender:
    """Return a sender, which reads the certificates once."""
    return Sender(Targets(networks), timeout_s)


@dataclass
class Deployment:
    """A database with two fleets of one wheelset, and what delivers from it."""

    storage: SqlStorage
    clock: MovedClock
    timeout_s: float = 5.0

    def deliver(
        self, seconds_later: float = 0.0, networks: Sequence[Network] = LOOPBACK, storage: SqlStorage | None = None
    ) -> None:
        """Move the clock, send what is due, as a process that has just begun, and wait for it."""
        self.clock.now += round(seconds_later * SECOND)

        async def once() -> None:
            sender = _sender(tuple(networks), self.timeout_s)
            deliveries = Deliveries(storage or self.storage, sender, self.clock, chance=lambda: NO_JITTER)
            await deliveries.look()
            await deliveries.finished()

        asyncio.run(once())

    def webhook(self, url: str, **fields: object) -> int:
        """Make a webhook and return its number."""
        none: frozenset[str] = frozenset()
        now = self.clock.now
        with self.storage.write() as unit:
            position = unit.feed_branches.newest_sequence()
            active = WebhookState.ACTIVE
            one = Webhook(0, url, "", none, none, none, None, active, None, now, now, "a test", position)
            return unit.webhooks.add(replace(one, **fields), new_secret()).webhook_id  # type: ignore[arg-type]

    def raise_alert(self, kind: str, serial: str = "WS-A", fleet: str = "alpha") -> None:
        api_fleet.raised(self.storage, serial, kind, fleet)

    def state(self, webhook_id: int) -> Webhook:
        with self.storage.read() as unit:
            return unit.webhooks.get(webhook_id)

    def sent(self, webhook_id: int) -> Sequence[Delivery]:
        with self.storage.read() as unit:
            return unit.webhooks.deliveries(webhook_id, None, 100)

    def change(self, webhook_id: int, **fields: object) -> None:
        with self.storage.write() as unit:
            unit.webhooks.change(replace(unit.webhooks.locked(webhook_id), **fields))  # type: ignore[arg-type]


@pytest.fixture
def deployment(storage: SqlStorage) -> Deployment:
    """Return a deployment, once on each database."""
    return _deployment(storage)


@pytest.fixture
def embedded(sqlite_storage: SqlStorage) -> Deployment:
    """Return one for what does not depend on the database."""
    return _deployment(sqlite_storage)


def _deployment(storage: SqlStorage) -> Deployment:
    with storage.write() as unit:
        for fleet, serial in (("alpha", "WS-A"), ("beta", "WS-B")):
            unit.registry.add_fleet(FleetRecord(fleet, fleet))
            unit.registry.add_wheelset(WheelsetRecord(serial, fleet, "P8", 0.46, None))
    return Deployment(storage, MovedClock())


@pytest.fixture
def receiver() -> Iterator[Receiver]:
    with receiving() as found:
        yield found


def _kinds(receiver: Receiver) -> list[str]:
    return [json.loads(one.body)["data"]["alert"]["kind"] for one in receiver.received]


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
    assert _kinds(receiver) == ["conicity_limit", "identity", "model_mismatch"]
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
    assert _kinds(receiver) == ["conicity_limit", "identity"]


def test_410_disables_at_once(embedded: Deployment, receiver: Receiver) -> None:
    receiver.answer = Answer(410)
    number = embedded.webhook(receiver.url)
    embedded.raise_alert("conicity_limit")
    embedded.deliver()
    embedded.deliver(DAY_S)
    found = embedded.state(number)
    assert (found.state, found.disabled_reason, found.position) == (WebhookState.DISABLED, DisabledReason.GONE, 0)
    assert len(receiver.received) == 1


def test_a_redirect_to_loopback_is_not_followed(embedded: Deployment, receiver: Receiver) -> None:
    with receiving() as inside:
        receiver.answer = Answer(307, {"Location": inside.url})
        number = embedded.webhook(receiver.url)
        embedded.raise_alert("conicity_limit")
        embedded.deliver()
        (waits,) = embedded.sent(number)
        assert (waits.failure, waits.status_code, waits.state) == (Failure.REDIRECT, 307, DeliveryState.WAITING)
        assert len(receiver.received) == 1
        assert inside.received == []


def test_names_and_addresses_of_the_machine_are_refused_when_something_is_sent(
    embedded: Deployment, receiver: Receiver, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The numbers and names below all connect to the receiver, as the last lines show."""
    hosts = ("localhost", "127.0.0.1", "127.1", "2130706433", "0x7f000001", "[::ffff:127.0.0.1]")
    monkeypatch.setenv("HTTP_PROXY", f"http://127.0.0.1:{receiver.port}")
    monkeypatch.setenv("HTTPS_PROXY", f"http://127.0.0.1:{receiver.port}")
    numbers = [
        embedded.webhook(f"{scheme}://{host}:{receiver.port}/") for host in hosts for scheme in ("http", "https")
    ]
    nowhere = embedded.webhook("https://receiver.invalid/")
    embedded.raise_alert("conicity_limit")
    embedded.deliver(networks=networks_of("10.0.0.0/8"))
    assert {embedded.sent(one)[0].failure for one in numbers} == {Failure.REFUSED_ADDRESS}
    assert embedded.sent(nowhere)[0].failure is Failure.UNKNOWN_HOST
    assert receiver.received == []
    embedded.deliver(6.0)
    assert [embedded.sent(one)[0].failure for one in numbers] == [None, Failure.TLS] * len(hosts)
    assert {one.headers["host"] for one in receiver.received} >= {
        f"localhost:{receiver.port}",
        f"127.1:{receiver.port}",
    }


def test_a_receiver_that_never_answers_delays_no_other(embedded: Deployment, receiver: Receiver) -> None:
    receiver.answer = Answer(wait_s=60.0)
    embedded.timeout_s = 1.0
    with receiving() as quick:
        stuck, well = embedded.webhook(receiver.url), embedded.webhook(quick.url)
        for kind in ("conicity_limit", "identity", "model_mismatch"):
            embedded.raise_alert(kind)
        embedded.deliver()
        assert _kinds(quick) == ["conicity_limit", "identity", "model_mismatch"]
        (waits,) = embedded.sent(stuck)
        assert (waits.failure, waits.status_code, waits.attempts) == (Failure.TIMEOUT, None, 1)
        assert max(one.last_ns for one in embedded.sent(well)) <= waits.last_ns


def test_an_answer_without_end_is_cut_off(embedded: Deployment, receiver: Receiver) -> None:
    receiver.answer = Answer(200, endless=True)
    number = embedded.webhook(receiver.url)
    embedded.raise_alert("conicity_limit")
    embedded.deliver()
    assert embedded.sent(number)[0].state is DeliveryState.DELIVERED
    assert MOST_ANSWER_BYTES <= receiver.said_bytes < 1 << 26, "all but the buffers of the system was taken"


def test_a_name_that_changes_after_the_check_leads_nowhere_else(
    embedded: Deployment, receiver: Receiver, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The name server answers with the receiver first, then with an address of the machine that is not allowed."""
    answers = iter(["127.0.0.1", *["127.0.0.2"] * 9])
    system = socket.getaddrinfo

    def changing(host: str | bytes | None, *rest: object, **named: object) -> object:
        return system(next(answers) if host == "receiver.example" else host, *rest, **named)  # type: ignore[arg-type]

    monkeypatch.setattr(socket, "getaddrinfo", changing)
    only = networks_of("127.0.0.1/32")
    number = embedded.webhook(f"http://receiver.example:{receiver.port}/")
    embedded.raise_alert("conicity_limit")
    embedded.raise_alert("identity")
    embedded.deliver(networks=only)
    assert [one.headers["host"] for one in receiver.received] == [f"receiver.example:{receiver.port}"]
    assert [one.failure for one in embedded.sent(number)] == [Failure.REFUSED_ADDRESS, None]


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
        assert _kinds(receiver) == ["identity", "conicity_limit", "identity"]
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


def _certificate(folder: Path, name: str) -> tuple[Path, ssl.SSLContext]:
    """Return the file of a certificate that a name signed for itself, and the context of a server that has it."""
    key = ec.generate_private_key(ec.SECP256R1())
    subject = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, name)])
    now = dt.datetime.now(dt.UTC)
    made = (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(subject)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - dt.timedelta(days=1))
        .not_valid_after(now + dt.timedelta(days=1))
        .add_extension(x509.SubjectAlternativeName([x509.DNSName(name)]), critical=False)
        .add_extension(x509.BasicConstraints(ca=True, path_length=None), critical=True)
        .sign(key, hashes.SHA256())
    )
    certificate, private = folder / f"{name}.pem", folder / f"{name}.key"
    certificate.write_bytes(made.public_bytes(serialization.Encoding.PEM))
    plain = serialization.NoEncryption()
    private.write_bytes(key.private_bytes(serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, plain))
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(certificate, private)
    return certificate, context


def test_https_goes_to_the_checked_address_under_the_name_of_the_url(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    named: list[str | None] = []
    certificate, context = _certificate(tmp_path, "localhost")
    _, of_another = _certificate(tmp_path, "receiver.example")
    context.sni_callback = lambda _socket, name, _context: named.append(name)
    monkeypatch.setenv("SSL_CERT_FILE", str(certificate))

    async def sent(url: str) -> tuple[int | None, Failure | None]:
        outcome = await Sender(Targets(LOOPBACK), 5.0).send(url, {}, b"{}")
        return outcome.status_code, outcome.failure

    with receiving(context) as right, receiving(of_another) as wrong:
        assert asyncio.run(sent(f"https://localhost:{right.port}/hook")) == (204, None)
        assert named == ["localhost"]
        assert right.received[0].headers["host"] == f"localhost:{right.port}"
        assert asyncio.run(sent(f"https://localhost:{wrong.port}/hook")) == (None, Failure.TLS)
        assert asyncio.run(sent(f"https://127.0.0.1:{right.port}/hook")) == (None, Failure.TLS)
        assert wrong.received == []
    began = time.monotonic()
    assert asyncio.run(sent(f"http://127.0.0.1:{right.port}/")) == (None, Failure.UNREACHABLE)
    assert time.monotonic() - began < 5.0
