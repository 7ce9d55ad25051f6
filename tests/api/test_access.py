"""Keys at the running service: what they do, what is recorded, and what is refused."""

from __future__ import annotations

import sqlite3
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from guarded_service import Guarded, guarded_service, settings_in

from api.access import key_ring
from api.access.guard import guard_of
from api.feed import watch as feed_watch
from estimation.errors import ParameterError
from fleet_db.stores.access import ApiKeyStore

JSON = {"Content-Type": "application/json"}


@pytest.fixture(scope="module")
def guarded(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Guarded]:
    with guarded_service(tmp_path_factory.mktemp("guarded"), failed_keys_per_minute=6e4) as service:
        yield service


def soon(found: Callable[[], bool]) -> bool:
    """Return whether it is so within some seconds: refusals are written beside the requests."""
    until = time.monotonic() + 60.0
    while not found():
        if time.monotonic() > until:
            return False
        time.sleep(0.05)
    return True


def test_a_key_made_by_rest_works_is_shown_once_and_stored_as_digest(guarded: Guarded) -> None:
    boss = guarded.key("boss")
    wanted = {"owner": "depot west", "scopes": ["read"], "fleets": ["alpha"], "expires_at": "2100-01-01T00:00:00Z"}
    made = guarded.client.post("/v1/keys", headers=boss, json=wanted)
    assert (made.status_code, made.headers["cache-control"]) == (201, "no-store")
    secret = made.json()["key"]
    assert guarded.client.get("/v1/wheelsets/WS-A", headers={"Authorization": f"Bearer {secret}"}).status_code == 200
    shown = guarded.client.get(made.headers["location"], headers=boss)
    assert shown.json() == {name: value for name, value in made.json().items() if name != "key"} | {
        "last_used_at": shown.json()["last_used_at"]
    }
    assert (shown.json()["owner"], shown.json()["created_by"]) == ("depot west", "boss")
    stored = b"".join(path.read_bytes() for path in guarded.storage.data_dir.glob("treadwatch.sqlite*"))
    assert made.json()["prefix"].encode() in stored
    assert secret[-43:].encode() not in stored
    assert soon(lambda: guarded.client.get(made.headers["location"], headers=boss).json()["last_used_at"] is not None)


def test_a_revoked_key_is_refused(guarded: Guarded, monkeypatch: pytest.MonkeyPatch) -> None:
    boss, other = guarded.key("boss"), guarded.key("other")
    assert guarded.client.get("/v1/fleets", headers=other).status_code == 200
    monkeypatch.setattr(key_ring, "AGAIN_S", 0.0)  # in place of the seconds for which a key is remembered
    monkeypatch.setattr(key_ring, "AT_MOST_S", 0.0)
    prefix = other["Authorization"].split("_")[1]
    assert guarded.client.post(f"/v1/keys/{prefix}/revoke", headers=boss).json()["revoked_at"] is not None
    assert guarded.client.get("/v1/fleets", headers=other).status_code == 401
    assert guarded.client.post(f"/v1/keys/{prefix}/revoke", headers=boss).status_code == 409


def test_the_stream_and_the_long_poll_of_a_revoked_key_end(guarded: Guarded, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(key_ring, "AGAIN_S", 0.0)
    monkeypatch.setattr(key_ring, "AT_MOST_S", 0.0)
    monkeypatch.setattr(feed_watch, "ASKED_EVERY_S", 0.2)
    boss, other = guarded.key("boss"), guarded.key("other")
    latest = guarded.client.get("/v1/alerts/feed?after=latest", headers=other).json()["next_cursor"]
    with (
        ThreadPoolExecutor() as pool,
        guarded.client.stream("GET", "/v1/alerts/feed/stream", headers=other) as response,
    ):
        parts = response.iter_bytes()
        assert next(parts)
        waiting = {"after": latest, "wait_s": "3"}
        polled = pool.submit(guarded.client.get, "/v1/alerts/feed", params=waiting, headers=other)
        time.sleep(0.5)  # it waits
        prefix = other["Authorization"].split("_")[1]
        began = time.monotonic()
        assert guarded.client.post(f"/v1/keys/{prefix}/revoke", headers=boss).status_code == 200
        for _ in parts:
            pass
        assert time.monotonic() - began < feed_watch.HEARTBEAT_S  # it ends, and not at a sign of life
        assert polled.result().status_code == 401
        assert polled.result().headers["www-authenticate"].endswith('error="invalid_token"')


def test_how_often_a_stream_asks_for_its_key() -> None:
    assert feed_watch.ASKED_EVERY_S + key_ring.AT_MOST_S <= 20.0


def test_a_key_is_read_once_for_many_requests(guarded: Guarded, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(key_ring, "AGAIN_S", 3600.0)  # however slow the machine is
    monkeypatch.setattr(key_ring, "AT_MOST_S", 3600.0)
    read: list[str] = []
    find = ApiKeyStore.find
    monkeypatch.setattr(ApiKeyStore, "find", lambda store, prefix: read.append(prefix) or find(store, prefix))
    key = guarded.key()
    del read[:]  # making it looks whether there is one of that prefix
    for _ in range(20):
        assert guarded.client.get("/v1/fleets", headers=key).status_code == 200
    assert len(read) == 1


@pytest.mark.parametrize(
    ("wanted", "status"),
    [
        ({"owner": "x", "scopes": ["root"], "fleets": None}, 422),
        ({"owner": "x", "scopes": [], "fleets": None}, 422),
        ({"owner": "x", "scopes": ["read"]}, 422),
        ({"owner": "\u0007", "scopes": ["read"], "fleets": None}, 422),
        ({"owner": "x", "scopes": ["read"], "fleets": ["nowhere"]}, 404),
        ({"owner": "x", "scopes": ["read"], "fleets": None, "expires_at": "2001-01-01T00:00:00Z"}, 422),
    ],
)
def test_a_key_that_makes_no_sense_is_not_made(guarded: Guarded, wanted: object, status: int) -> None:
    assert guarded.client.post("/v1/keys", headers=guarded.key(), json=wanted).status_code == status


def test_an_administrator_of_one_fleet_makes_no_keys(guarded: Guarded) -> None:
    """Otherwise it could make one for all fleets."""
    bound = guarded.key("depot", fleet="alpha")
    wanted = {"owner": "x", "scopes": ["read"], "fleets": None}
    assert guarded.client.post("/v1/keys", headers=bound, json=wanted).status_code == 403
    assert guarded.client.get("/metrics", headers=bound).status_code == 403
    assert guarded.client.get("/metrics", headers=guarded.key()).status_code == 200


def test_who_acts_is_the_owner_of_the_key(guarded: Guarded) -> None:
    key, path = guarded.key("j.smith"), guarded.alert()
    key |= {"If-Match": "*"}
    refused = guarded.client.post(f"{path}/acknowledge", headers=key, json={"by": "somebody else"})
    assert (refused.status_code, refused.json()["errors"][0]["pointer"]) == (422, "#/by")
    done = guarded.client.post(f"{path}/acknowledge", headers=key, json={"note": "seen"})
    assert (done.status_code, done.json()["acknowledged_by"]) == (200, "j.smith")
    events = guarded.client.get(f"{path}/events", headers=key).json()["items"]
    assert [(event["event"], event["actor"]) for event in events][-1] == ("acknowledged", "j.smith")


def test_an_idempotency_key_belongs_to_the_key_that_sent_it(guarded: Guarded) -> None:
    path, first, second = guarded.alert(), guarded.key("first"), guarded.key("second")
    sent = {"If-Match": "*", "Idempotency-Key": "same"}
    body = {"ref": "maximo:1"}
    assert guarded.client.post(f"{path}/external-refs", headers=first | sent, json=body).status_code == 200
    repeated = guarded.client.post(f"{path}/external-refs", headers=first | sent, json=body)
    assert repeated.headers["idempotency-replayed"] == "true"
    other = guarded.client.post(f"{path}/external-refs", headers=second | sent, json={"ref": "sap:2"})
    assert (other.status_code, "idempotency-replayed" in other.headers) == (200, False)


def test_changes_and_refusals_are_in_the_audit_log_without_secrets(guarded: Guarded) -> None:
    boss, path = guarded.key("auditor"), guarded.alert()
    changed = guarded.client.post(f"{path}/external-refs", headers=boss | {"If-Match": "*"}, json={"ref": "hunter2"})
    weak = guarded.key("weak", without="act")
    guarded.client.post(f"{path}/acknowledge", headers=weak | {"If-Match": "*"}, json={})
    guarded.client.get("/v1/fleets?secret=hunter2", headers={"Authorization": "Bearer hunter2"})

    def entries(**filters: object) -> list[dict[str, object]]:
        found: list[dict[str, object]] = guarded.client.get("/v1/audit", headers=boss, params=filters).json()["items"]
        return found

    (mine,) = entries(owner="auditor")
    assert (mine["method"], mine["path"], mine["status"]) == ("POST", f"{path}/external-refs", 200)
    assert mine["key_prefix"] == boss["Authorization"].split("_")[1]
    assert (mine["address"], mine["request_id"]) == ("127.0.0.1", changed.headers["x-request-id"])
    assert soon(lambda: bool(entries(owner="weak", status=403)))
    assert soon(lambda: any(entry["path"] == "/v1/fleets" for entry in entries(status=401)))
    assert "hunter2" not in guarded.client.get("/v1/audit?limit=1000", headers=boss).text
    page = guarded.client.get("/v1/audit?limit=1", headers=boss).json()
    following = guarded.client.get(page["next"], headers=boss).json()
    assert following["items"][0]["id"] < page["items"][0]["id"]


@pytest.mark.parametrize("host", ["evil.example", "localhost.evil.example", "user@localhost", "[::2]", "127.0.0.2:80"])
def test_another_name_in_host_is_refused(guarded: Guarded, host: str) -> None:
    refused = guarded.client.get("/healthz", headers={"Host": host})
    assert (refused.status_code, refused.json()["type"]) == (421, "urn:treadwatch:problem:unknown-host")


@pytest.mark.parametrize("host", ["localhost", "LOCALHOST:8000", "127.0.0.1:1", "[::1]:9"])
def test_names_of_loopback_are_ours(guarded: Guarded, host: str) -> None:
    assert guarded.client.get("/healthz", headers={"Host": host}).status_code == 200


def test_a_page_of_another_origin_changes_nothing_and_reads_nothing(guarded: Guarded) -> None:
    key = guarded.key()
    for origin in ("https://evil.example", "null", f"https://{guarded.client.base_url.host}"):
        refused = guarded.client.post("/v1/jobs/estimate_windows/runs", headers=key | {"Origin": origin})
        assert (refused.status_code, refused.json()["type"]) == (403, "urn:treadwatch:problem:foreign-origin")
    read = guarded.client.get("/v1/fleets", headers=key | {"Origin": "https://evil.example"})
    assert "access-control-allow-origin" not in read.headers
    ours = str(guarded.client.base_url).rstrip("/")
    assert guarded.client.post("/v1/keys", headers=key | {"Origin": ours}, json={}).status_code == 422


def test_every_answer_says_what_browsers_must_not_do(guarded: Guarded) -> None:
    for path in ("/", "/healthz", "/v1/fleets", "/nowhere"):
        headers = guarded.client.get(path).headers
        assert headers["x-content-type-options"] == "nosniff"
        assert headers["referrer-policy"] == "no-referrer"
        assert "frame-ancestors 'none'" in headers["content-security-policy"]
        assert "unsafe" not in headers["content-security-policy"]
        assert "strict-transport-security" not in headers


def test_what_is_open_is_health_and_the_page(guarded: Guarded) -> None:
    assert {guarded.client.get(path).status_code for path in ("/healthz", "/readyz", "/")} == {200}
    closed = ("/metrics", "/docs", "/openapi.json", "/docs/assets/swagger-ui.css", "/v1/fleets", "/nowhere")
    assert {guarded.client.get(path).status_code for path in closed} == {401}
    assert guarded.client.post("/healthz").status_code == 405


def test_other_settings_open_and_shut_doors_and_let_pages_in(tmp_path: Path) -> None:
    """One service for all of them: names, origins, HTTPS, doors, and every limit of rate."""
    changed = {
        "hosts": "depot.example, other.example",
        "origins": "https://maintenance.example",
        "https": True,
        "metrics": "open",
        "docs": "off",
        "requests_per_s": 0.5,
        "requests_burst": 3,
        "failed_keys_per_minute": 2,
        "max_body_kb": 1,
    }
    with guarded_service(tmp_path, **changed) as guarded:
        client, key = guarded.client, guarded.key()
        assert client.get("/healthz", headers={"Host": "Depot.example:443"}).status_code == 200
        assert client.get("/metrics").status_code == 200
        assert client.get("/docs", headers=key).status_code == 404
        page = {"Origin": "https://maintenance.example"}
        asked = client.options("/v1/fleets", headers=page | {"Access-Control-Request-Method": "GET"})
        assert asked.headers["access-control-allow-origin"] == "https://maintenance.example"
        read = client.get("/v1/fleets", headers=page | key)
        assert read.headers["access-control-allow-origin"] == "https://maintenance.example"
        assert read.headers["strict-transport-security"].startswith("max-age=")
        large = client.post("/v1/keys", headers=page | key | JSON, content=b"x" * 2000)
        assert (large.status_code, "max_body_kb" in large.json()["detail"]) == (413, True)
        statuses = [client.get("/v1/fleets", headers=key).status_code for _ in range(4)]
        assert statuses[-1] == 429
        late = client.get("/v1/fleets", headers=key)
        assert (late.json()["type"], late.headers["retry-after"]) == ("urn:treadwatch:problem:too-many-requests", "2")
        wrong = [client.get("/v1/fleets", headers={"Authorization": "Bearer x"}).status_code for _ in range(3)]
        assert wrong == [401, 401, 429]
        assert client.get("/v1/fleets", headers=key).status_code == 429  # by its own limit: it is still known
        assert "requests_per_s" in client.get("/v1/fleets", headers=key).json()["detail"]


def test_open_access_beyond_this_machine_must_be_said_in_words(tmp_path: Path) -> None:
    for host in ("0.0.0.0", "::", "192.0.2.1", "depot.example"):  # noqa: S104 - what is refused
        with pytest.raises(ParameterError, match="reached from beyond this machine") as refused:
            guard_of(settings_in(tmp_path, access="open", host=host), pytest.fail)
        assert refused.value.field == "TREADWATCH_ACCESS"
        guard_of(settings_in(tmp_path, access="open to everyone who reaches this address", host=host), pytest.fail)
        guard_of(settings_in(tmp_path, host=host), pytest.fail)
    for host in ("127.0.0.1", "localhost", "::1"):
        assert guard_of(settings_in(tmp_path, access="open", host=host), pytest.fail).gate.keys is None


def test_the_audit_log_is_only_added_to(guarded: Guarded) -> None:
    """A number is never given twice, also after the newest entry was purged."""
    with sqlite3.connect(guarded.storage.data_dir / "treadwatch.sqlite") as connection:
        (made,) = connection.execute("SELECT sql FROM sqlite_master WHERE name = 'audit_entries'").fetchone()
    assert "AUTOINCREMENT" in made
