"""Tokens of a real issuer: an HTTP server that publishes its keys, and signs."""

from __future__ import annotations

import base64
import hashlib
import hmac
import json
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import timedelta
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import httpx
import jwt
import pytest
from cryptography.hazmat.primitives.asymmetric import ec, rsa
from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat
from guarded_service import Guarded, guarded_service, settings_in

from api.access import key_ring
from api.access.guard import guard_of
from estimation.errors import ParameterError

AUDIENCE = "treadwatch"


@dataclass
class Issuer:
    """Signs with keys of its own, and counts how often its published ones are fetched."""

    url: str = ""
    fetched: int = 0
    keys: dict[str, Any] = field(default_factory=dict)

    def published(self) -> bytes:
        """Return the JSON Web Key Set, with a key that encrypts and one that nobody knows."""
        found = []
        for name, key in self.keys.items():
            kind = jwt.algorithms.RSAAlgorithm if name.startswith("rsa") else jwt.algorithms.ECAlgorithm
            found.append({**json.loads(kind.to_jwk(key.public_key())), "kid": name, "use": "sig"})
        other = [{"kty": "RSA", "use": "enc", "kid": "enc"}, {"kty": "new", "kid": "new"}]
        return json.dumps({"keys": [*other, *found]}).encode()

    def token(self, kid: str = "rsa-1", algorithm: str = "RS256", **changed: object) -> str:
        """Return a token; claims that are None are left out."""
        claims = {
            "iss": self.url,
            "aud": AUDIENCE,
            "sub": "7f3",
            "name": "J. Smith",
            "exp": time.time() + 300,
            "scope": "openid read",
            "fleets": ["alpha"],
        }
        kept = {name: value for name, value in {**claims, **changed}.items() if value is not None}
        return jwt.encode(kept, self.keys[kid], algorithm=algorithm, headers={"kid": kid})


@contextmanager
def issuing() -> Iterator[Issuer]:
    issuer = Issuer(
        keys={"rsa-1": rsa.generate_private_key(65537, 2048), "ec-1": ec.generate_private_key(ec.SECP256R1())}
    )

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            issuer.fetched += 1
            body = issuer.published()
            self.send_response(200)
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, *_: object) -> None:
            """Say nothing."""

    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        issuer.url = f"http://127.0.0.1:{server.server_address[1]}"
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield issuer
        server.shutdown()
        thread.join()


@pytest.fixture(scope="module")
def issuer() -> Iterator[Issuer]:
    with issuing() as one:
        yield one


@pytest.fixture(scope="module")
def guarded(issuer: Issuer, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Guarded]:
    settings = {
        "oidc_issuer": issuer.url,
        "oidc_audience": AUDIENCE,
        "oidc_keys": f"{issuer.url}/keys",
        "oidc_owner_claim": "name",
        "failed_keys_per_minute": 6e4,
    }
    with guarded_service(tmp_path_factory.mktemp("tokens"), **settings) as service:
        yield service


def ask(guarded: Guarded, token: str, path: str = "/v1/wheelsets/WS-A") -> httpx.Response:
    return guarded.client.get(path, headers={"Authorization": f"Bearer {token}"})


def test_a_token_sees_its_fleets_and_does_what_its_scopes_allow(guarded: Guarded, issuer: Issuer) -> None:
    assert ask(guarded, issuer.token()).status_code == 200
    assert ask(guarded, issuer.token("ec-1", "ES256")).status_code == 200
    assert ask(guarded, issuer.token(), "/v1/wheelsets/WS-B").status_code == 404
    assert ask(guarded, issuer.token(fleets="*"), "/v1/wheelsets/WS-B").status_code == 200
    assert ask(guarded, issuer.token(fleets=None)).status_code == 404  # names no fleet: it sees none
    assert ask(guarded, issuer.token(scope="openid")).status_code == 403
    assert ask(guarded, issuer.token(scope=["read"])).status_code == 200
    acting = {"Authorization": f"Bearer {issuer.token(scope='act read')}", "If-Match": "*"}
    done = guarded.client.post(f"{guarded.alert()}/acknowledge", headers=acting, json={})
    assert (done.status_code, done.json()["acknowledged_by"]) == (200, "J. Smith")
    assert ask(guarded, issuer.token(exp=time.time() - 10)).status_code == 200  # clocks may differ by 30 s


@pytest.mark.parametrize(
    "changed",
    [
        {"exp": timedelta(seconds=-60)},
        {"exp": None},
        {"nbf": timedelta(hours=1)},
        {"aud": "another"},
        {"aud": None},
        {"iss": "https://another.example"},
        {"iss": None},
        {"name": None},
        {"name": ["J. Smith"]},
        {"sub": None},
    ],
    ids=str,
)
def test_a_token_that_is_not_meant_for_us_is_refused(guarded: Guarded, issuer: Issuer, changed: dict[str, Any]) -> None:
    now_s = time.time()
    claims = {
        name: now_s + value.total_seconds() if isinstance(value, timedelta) else value
        for name, value in changed.items()
    }
    assert ask(guarded, issuer.token(**claims)).status_code == 401


def part(value: object) -> str:
    return base64.urlsafe_b64encode(json.dumps(value).encode()).decode().rstrip("=")


def test_a_token_that_nobody_signed_is_refused(guarded: Guarded, issuer: Issuer) -> None:
    """Neither none, nor HS with the public key as the secret, nor another's key, nor a changed content."""
    header, claims, signature = issuer.token().split(".")
    unsigned = f"{part({'alg': 'none', 'kid': 'rsa-1'})}.{claims}."
    public = issuer.keys["rsa-1"].public_key().public_bytes(Encoding.PEM, PublicFormat.SubjectPublicKeyInfo)
    symmetric = f"{part({'alg': 'HS256', 'kid': 'rsa-1', 'typ': 'JWT'})}.{claims}"
    code = hmac.new(public, symmetric.encode(), hashlib.sha256).digest()
    symmetric += "." + base64.urlsafe_b64encode(code).decode().rstrip("=")
    forged = jwt.encode({}, rsa.generate_private_key(65537, 2048), algorithm="RS256", headers={"kid": "rsa-1"})
    edited = json.loads(base64.urlsafe_b64decode(claims + "=="))
    changed = f"{header}.{part(edited | {'fleets': '*'})}.{signature}"
    others = [f"{header}.{claims}.", f"{header}.{claims}", "a.b.c", f"{header}.{signature}.{claims}", "." * 50]
    for token in (unsigned, symmetric, forged, changed, *others):
        assert ask(guarded, token).status_code == 401, token


def test_new_keys_are_fetched_at_most_once_a_minute(
    guarded: Guarded, issuer: Issuer, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert ask(guarded, issuer.token()).status_code == 200
    before = issuer.fetched
    issuer.keys["rsa-2"] = rsa.generate_private_key(65537, 2048)
    assert [ask(guarded, issuer.token("rsa-2")).status_code for _ in range(3)] == [401, 401, 401]
    assert issuer.fetched == before
    monkeypatch.setattr(key_ring, "REFRESH_S", 0.0)  # in place of the minute
    assert ask(guarded, issuer.token("rsa-2")).status_code == 200
    assert issuer.fetched == before + 1


def test_keys_may_be_in_a_file_and_the_settings_are_complete_or_refused(issuer: Issuer, tmp_path: Path) -> None:
    file = tmp_path / "keys.json"
    file.write_bytes(issuer.published())
    given = {"oidc_issuer": issuer.url, "oidc_audience": AUDIENCE, "oidc_keys": str(file)}
    with guarded_service(tmp_path / "data", **given) as guarded:
        assert ask(guarded, issuer.token()).status_code == 200
    for name in given:
        with pytest.raises(ParameterError) as refused:
            guard_of(settings_in(tmp_path, **{**given, name: None}), pytest.fail)
        assert refused.value.field == f"TREADWATCH_{name.upper()}"
    with pytest.raises(ValueError, match="must be https"):
        settings_in(tmp_path, **{**given, "oidc_keys": "http://login.example/keys"})
