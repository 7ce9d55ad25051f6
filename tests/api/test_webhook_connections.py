"""To whom deliveries connect, and for how long: redirects, names, addresses, certificates, answers without end."""

from __future__ import annotations

import asyncio
import datetime as dt
import socket
import ssl
import time
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from webhook_deployment import LOOPBACK, Deployment, kinds_of
from webhook_receiver import Answer, Receiver, receiving

from api.webhooks.sending import MOST_ANSWER_BYTES, Sender, Targets, networks_of
from fleet_db.records import DeliveryState, Failure


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
        assert kinds_of(quick) == ["conicity_limit", "identity", "model_mismatch"]
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
