"""Every operation of the document, asked by everyone who must not get it: from the running service.

A new operation is covered by itself, or a test says which example it needs in ``access_examples``.
"""

from __future__ import annotations

import json
import re
import time
import uuid
from collections.abc import Iterator, Mapping
from contextlib import closing, suppress
from dataclasses import dataclass, replace
from http import HTTPStatus
from pathlib import Path

import access_examples as examples
import httpx
import psycopg
import pytest
import sqlalchemy
from access_examples import Named
from one_database import in_turn
from running_service import running

from api.access.keys import Wanted, digest_of, make_key
from api.app import committed_document
from api.factory import open_store
from api.settings import Settings
from fleet_db.migrate import upgrade

EVERYTHING = frozenset({"read", "act", "ingest", "admin"})
NEEDS_NONE = frozenset({"/healthz", "/readyz"})
FIRST_OF_A_STREAM_S = 1.0
"""How long the beginning of a stream is read, in seconds."""
OWN = frozenset({examples.FLEET})


@dataclass(frozen=True)
class Operation:
    """One operation of the document."""

    name: str
    method: str
    path: str
    scope: str | None
    query: tuple[str, ...]
    has_body: bool
    streams: bool

    @property
    def first(self) -> Named | str | None:
        """What the first parameter of its path names."""
        if "{" not in self.path:
            return None
        template = self.path[: self.path.index("}") + 1]
        assert template in examples.PATHS, f"add an example for {template} to access_examples.PATHS"
        return examples.PATHS[template]

    def at(self, first: str) -> str:
        """Return its path with its first parameter filled in."""
        rest = re.sub(r"\{\w+\}", first, self.path, count=1)
        for name in re.findall(r"\{(\w+)\}", rest):
            assert name in examples.DEEPER, f"add an example for {name} of {self.name} to access_examples.DEEPER"
            rest = rest.replace(f"{{{name}}}", examples.DEEPER[name])
        return rest


def _operations() -> list[Operation]:
    return [
        Operation(
            one["operationId"],
            method.upper(),
            path,
            one["security"][0]["key"][0] if one["security"] else None,
            tuple(entry["name"] for entry in one.get("parameters", ()) if entry["in"] == "query"),
            "application/json" in one.get("requestBody", {}).get("content", ()),
            any("text/event-stream" in response.get("content", {}) for response in one["responses"].values()),
        )
        for path, methods in json.loads(committed_document())["paths"].items()
        for method, one in methods.items()
    ]


OPERATIONS = [one for one in _operations() if one.path not in NEEDS_NONE]


@dataclass(frozen=True)
class Guarded:
    """A service that asks for keys, the keys, and the numbers of alerts."""

    client: httpx.Client
    keys: Mapping[str, str]
    numbers: Mapping[str, str]

    def ask(
        self, operation: Operation, first: str = "", key: str | None = "all", query: Mapping[str, str] = {}
    ) -> httpx.Response:
        """Ask as the holder of a key, under any ETag."""
        headers = {"If-Match": "*"}
        if key is not None:
            headers["Authorization"] = f"Bearer {self.keys[key]}"
        body = examples.BODIES.get(operation.name, {}) if operation.has_body else None
        return self.send(operation, headers, first, body, query)

    def ask_with(self, operation: Operation, first: str, body: Mapping[str, object]) -> httpx.Response:
        """Ask with a body of one's own, as the caller who is bound to a fleet."""
        headers = {"If-Match": "*", "Authorization": f"Bearer {self.keys['own']}"}
        return self.send(operation, headers, first, body, {})

    def send(
        self,
        operation: Operation,
        headers: Mapping[str, str],
        first: str,
        body: Mapping[str, object] | None,
        query: Mapping[str, str],
    ) -> httpx.Response:
        """Send a request."""
        path = operation.at(self.numbers.get(first, first))
        query = {**examples.QUERIES.get(operation.name, {}), **query}
        asked = self.client.build_request(operation.method, path, headers=dict(headers), json=body, params=query)
        asked.extensions["timeout"]["read"] = FIRST_OF_A_STREAM_S if operation.streams else 60.0
        response, content = self.client.send(asked, stream=True), b""
        with closing(response), suppress(httpx.ReadTimeout):  # a stream does not end by itself
            for piece in response.iter_bytes():
                content += piece
        return httpx.Response(response.status_code, headers=_plain(response.headers), content=content)


@pytest.fixture(scope="module")
def postgresql_url(postgres_server_url: str) -> Iterator[str]:
    """Yield an empty database of this module's own."""
    name = f"access_{uuid.uuid4().hex}"
    with psycopg.connect(postgres_server_url, autocommit=True) as connection:
        connection.execute(f'CREATE DATABASE "{name}"')
        yield sqlalchemy.make_url(postgres_server_url).set(database=name).render_as_string(hide_password=False)
        connection.execute(f'DROP DATABASE "{name}" WITH (FORCE)')


@pytest.fixture(scope="module", params=in_turn)
def guarded(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Guarded]:
    folder: Path = tmp_path_factory.mktemp("guarded")
    url = None if request.param == "sqlite" else request.getfixturevalue("postgresql_url")
    settings = Settings(
        data_dir=folder,
        database_url=url,
        port=0,
        log_level="error",
        access="keys",
        window_length_s=30.0,
        requests_per_s=1e6,
        requests_burst=1_000_000,
        failed_keys_per_minute=6e4,
        _env_file=None,
    )
    upgrade(settings.url)
    storage = open_store(settings)
    numbers = examples.populate(storage)
    now_ns = time.time_ns()
    keys = {"wrong": f"tw_{'a' * 8}_{'b' * 43}", "malformed": "none", "empty": "-"}
    with storage.write() as unit:
        wanted = {"all": Wanted("all", EVERYTHING, None, None), "own": Wanted("own", EVERYTHING, OWN, None)}
        wanted |= {
            f"{kind} without {scope}": Wanted("less", EVERYTHING - {scope}, fleets, None)
            for scope in EVERYTHING
            for kind, fleets in (("all", None), ("own", OWN))
        }
        wanted |= {"revoked": wanted["all"], "expired": wanted["all"]}
        for name, one in wanted.items():
            made, token = make_key(unit, one, "the test", now_ns)
            keys[name] = token
            if name == "revoked":
                unit.api_keys.revoke(made.prefix, now_ns)
            if name == "expired":
                other = f"{'c' * 8}"
                keys[name] = token.replace(made.prefix, other)
                digest = digest_of(keys[name])
                unit.api_keys.add(replace(made, prefix=other, digest=digest, expires_ns=now_ns - 1))
    with running(settings) as address, httpx.Client(base_url=address, timeout=60.0) as client:
        yield Guarded(client, keys, numbers)
    storage.close()


def _plain(headers: httpx.Headers) -> dict[str, str]:
    return {name: value for name, value in headers.items() if name != "content-encoding"}


def _first(operation: Operation) -> str:
    named = operation.first
    return named.foreign if isinstance(named, Named) else named or ""


def _shape(response: httpx.Response, *names: str) -> tuple[int, str]:
    """Return status and body without what the request itself named."""
    text = response.text
    for name in sorted(names, key=len, reverse=True):
        text = re.sub(rf"(?<![\w-]){re.escape(name)}(?![\w-])", "<name>", text)
    return response.status_code, text


def test_without_a_good_key_nothing_is_answered(guarded: Guarded) -> None:
    """All bad keys get one and the same answer: it does not show which keys there are."""
    asked = 0
    for operation in OPERATIONS:
        first, answers = _first(operation), set()
        for key in ("wrong", "malformed", "empty", "expired", "revoked", None):
            response = guarded.ask(operation, first, key)
            assert response.status_code == HTTPStatus.UNAUTHORIZED, (operation, key, response.text)
            assert response.headers["www-authenticate"].startswith("Bearer")
            answers.add(response.text)
            asked += 1
        assert len(answers) == 1
        assert not examples.MARKERS.search(answers.pop().replace(operation.at(first), "").encode())
    print(f"{asked} requests of {len(OPERATIONS)} operations without a good key: 0 answered")  # noqa: T201 - the number is to be seen with -s


def test_without_its_scope_no_operation_is_answered(guarded: Guarded) -> None:
    asked = 0
    for operation in OPERATIONS:
        assert operation.scope in EVERYTHING, operation
        for kind in ("all", "own"):
            response = guarded.ask(operation, _first(operation), f"{kind} without {operation.scope}")
            assert response.status_code == HTTPStatus.FORBIDDEN, (operation, kind, response.text)
            assert response.json()["type"] == "urn:treadwatch:problem:forbidden"
            asked += 1
    print(f"{asked} requests of {len(OPERATIONS)} operations without their scope: 0 answered")  # noqa: T201 - the number is to be seen with -s


def test_what_a_foreign_fleet_has_is_as_if_it_were_not(guarded: Guarded) -> None:
    """Of objects in paths: the same answer, but for the name, as where there is no such object."""
    asked = 0
    for operation in OPERATIONS:
        named = operation.first
        if not isinstance(named, Named):
            continue
        foreign, missing = guarded.numbers.get(named.foreign, named.foreign), named.missing
        refused = guarded.ask(operation, foreign, "own")
        nothing = guarded.ask(operation, missing, "own")
        assert _shape(refused, foreign) == _shape(nothing, missing), operation
        assert refused.status_code == HTTPStatus.NOT_FOUND, (operation, refused.text)
        asked += 1
    assert asked
    print(f"{asked} operations on objects of a foreign fleet: 0 answered")  # noqa: T201 - the number is to be seen with -s


def test_filters_that_name_what_a_foreign_fleet_has_are_as_if_it_were_not(guarded: Guarded) -> None:
    asked = 0
    for operation in OPERATIONS:
        for name in operation.query:
            known = name in examples.FILTERS or name in examples.NAMING_NOTHING
            assert known, f"add an example for {name} of {operation.name} to access_examples"
        own = operation.first.own if isinstance(operation.first, Named) else operation.first or ""
        for name in set(operation.query) & set(examples.FILTERS):
            named = examples.FILTERS[name]
            foreign = guarded.numbers.get(named.foreign, named.foreign)
            answers = [
                _shape(guarded.ask(operation, own, "own", {name: value}), value) for value in (foreign, named.missing)
            ]
            assert answers[0] == answers[1], (operation, name)
            asked += 1
    print(f"{asked} filters that name objects of a foreign fleet: 0 answered")  # noqa: T201 - the number is to be seen with -s


def test_no_answer_holds_anything_of_a_foreign_fleet(guarded: Guarded) -> None:
    """Of lists, and of what all fleets share; a key of all fleets does find the marks in many of them."""
    shown = asked = 0
    for operation in OPERATIONS:
        named = operation.first
        if operation.method != "GET":
            continue
        for key in ("own", "all"):
            response = guarded.ask(operation, named.own if isinstance(named, Named) else named or "", key)
            found = examples.MARKERS.search(response.content)
            assert key == "all" or not found, (operation, found, response.text[:2000])
            shown += found is not None
            asked += key == "own"
    assert shown > 9, "the marks are found nowhere: the test cannot fail"
    print(f"{asked} operations that read: nothing of a foreign fleet; {shown} hold it for a key of all fleets")  # noqa: T201 - the number is to be seen with -s


def test_bodies_that_name_what_a_foreign_fleet_has_are_as_if_it_were_not(guarded: Guarded) -> None:
    """A body of an operation that a bound caller may use must name a foreign object, unless it can name none."""
    asked = 0
    for operation in OPERATIONS:
        if operation.has_body:
            assert operation.name in examples.BODIES, f"add an example for {operation.name} to access_examples.BODIES"
        if not operation.has_body or operation.name in examples.WITHOUT_NAMES:
            continue
        own = operation.first.own if isinstance(operation.first, Named) else operation.first or ""
        foreign = examples.BODIES[operation.name]
        written = json.dumps(foreign)
        for name, nothing in examples.NOWHERE.items():
            written = written.replace(f'"{name}"', f'"{nothing}"')
        assert written != json.dumps(foreign), f"the body of {operation.name} names nothing foreign"
        refused = guarded.ask_with(operation, own, foreign)
        missing = guarded.ask_with(operation, own, json.loads(written))
        assert refused.status_code in {HTTPStatus.NOT_FOUND, HTTPStatus.FORBIDDEN}, (operation, refused.text)
        assert _shape(refused, *examples.NOWHERE) == _shape(missing, *examples.NOWHERE.values()), operation
        asked += 1
    print(f"{asked} bodies that name objects of a foreign fleet: 0 answered")  # noqa: T201 - the same
