"""The reference client of the feed of alerts over HTTP: events in order, each handed over before its cursor is kept.

On a terminal an event is a line, and the cursor is in a file once the line is out.
"""

from __future__ import annotations

import random
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from http import HTTPStatus
from pathlib import Path
from typing import Any, TextIO

import httpx
import orjson

from estimation.errors import InputError, TreadwatchError
from fleet_db.atomic_files import write_atomically
from ingest.live.status import Backoff

TRY_AGAIN = frozenset({HTTPStatus.TOO_MANY_REQUESTS, HTTPStatus.REQUEST_TIMEOUT})
NEEDS_KEY = {
    HTTPStatus.UNAUTHORIZED: "the service needs a valid key: set TREADWATCH_KEY",
    HTTPStatus.FORBIDDEN: "the key in TREADWATCH_KEY does not allow this",
}


class RefusedError(TreadwatchError):
    """The service refuses, and would refuse again."""


class UnreachableError(TreadwatchError):
    """The service does not answer, or not now."""

    def __init__(self, reason: str, retry_after_s: float | None = None) -> None:
        self.retry_after_s = retry_after_s
        super().__init__(reason)


class OtherHistoryError(TreadwatchError):
    """The database was restored, or is another one; ``cursor`` is where to go on, None for the beginning."""

    def __init__(self, reason: str, cursor: str | None) -> None:
        self.cursor = cursor
        super().__init__(reason)


@dataclass(frozen=True, slots=True)
class Block:
    """One block of a stream of server-sent events."""

    identity: str | None
    data: str | None


def blocks(lines: Iterable[str]) -> Iterator[Block]:
    """Yield the blocks of a stream (WHATWG HTML, 9.2.6); one that ends in the middle is dropped."""
    identity: str | None = None
    data: list[str] = []
    for line in lines:
        name, _, value = line.partition(":")
        value = value.removeprefix(" ")
        if not line:
            yield Block(identity, "\n".join(data) if data else None)
            identity, data = None, []
        elif name == "id":
            identity = value
        elif name == "data":
            data.append(value)


def _checked(response: httpx.Response) -> Any:  # noqa: ANN401 - JSON
    if response.is_success:
        return _json(response)
    problem = _json(response)
    said = problem if isinstance(problem, dict) else {}
    detail = str(said.get("detail") or said.get("title") or f"the service answers {response.status_code}")
    status = response.status_code
    if status >= HTTPStatus.INTERNAL_SERVER_ERROR or status in TRY_AGAIN:
        after = response.headers.get("retry-after", "")
        raise UnreachableError(detail, float(after) if after.isdecimal() else None)
    if str(said.get("type", "")).endswith(":cursor-of-another-database"):
        raise OtherHistoryError(detail, said.get("next_cursor"))
    if status in NEEDS_KEY:
        raise RefusedError(f"{NEEDS_KEY[HTTPStatus(status)]} ({detail})")
    raise RefusedError(detail)


def _json(response: httpx.Response) -> Any:  # noqa: ANN401 - the same
    try:
        return orjson.loads(response.content)
    except orjson.JSONDecodeError:
        if response.is_success:
            raise RefusedError("the answer is no JSON: is this address the service's?") from None
        return None


FEED = "/v1/alerts/feed"
STREAM = f"{FEED}/stream"
EVENT_STREAM = "text/event-stream"
PAGE = 500
WAIT_S = 25
SILENCE_S = 40.0  # of a stream, whose signs of life come every 15 s; longer is a broken connection
FIRST_DELAY_S, LONGEST_DELAY_S = 0.5, 30.0
STREAM_FAILURES = 3  # streams that break without a word, one after the other, until the client polls instead
Event = dict[str, Any]


@dataclass(slots=True)
class Follower:
    """A client of the feed."""

    http: httpx.Client
    query: Sequence[tuple[str, str]]
    taker: Lines
    cursor: str | None
    sleep: Callable[[float], None] = time.sleep
    _delays: Backoff = field(default_factory=lambda: Backoff(FIRST_DELAY_S, LONGEST_DELAY_S))
    _silent_streams: int = 0

    def once(self) -> None:
        """Hand over what there is."""
        while self._guarded(lambda: self._page(wait_s=0)):
            pass

    def follow(self) -> None:
        """Hand over what there is and what happens, until it is interrupted."""
        while True:
            try:
                self._guarded(self._stream if self._silent_streams < STREAM_FAILURES else self._long_poll)
                self._delays.succeeded()
            except UnreachableError as error:
                delay_s = max(self._delays.failed(), error.retry_after_s or 0.0)
                self.taker.waiting(f"{error}; trying again")
                self.sleep(delay_s * random.uniform(0.5, 1.0))  # noqa: S311 - so that clients do not come back at once

    def _guarded(self, ask: Callable[[], bool]) -> bool:
        try:
            return ask()
        except OtherHistoryError as error:
            try:
                self.taker.restored(str(error), self._open_now(), error.cursor)
            except httpx.HTTPError as failed:
                raise UnreachableError(f"{self.http.base_url}: {failed or type(failed).__name__}") from None
            self.cursor = error.cursor
            return True
        except httpx.HTTPError as error:
            raise UnreachableError(f"{self.http.base_url}: {error or type(error).__name__}") from None

    def _parameters(self, **more: int) -> httpx.QueryParams:
        given: list[tuple[str, str | int | float | bool | None]] = [*self.query, *more.items()]
        return httpx.QueryParams(given if self.cursor is None else [*given, ("after", self.cursor)])

    def _page(self, wait_s: int) -> bool:
        parameters = self._parameters(limit=PAGE, wait_s=wait_s)
        page = _checked(self.http.get(FEED, params=parameters, timeout=wait_s + 30.0))
        for number, event in enumerate(page["items"], 1):
            last = number == len(page["items"])
            self.taker.event(event, page["next_cursor"] if last else self.cursor or "")
        self.cursor = page["next_cursor"]
        self.taker.moved(page["next_cursor"])
        return len(page["items"]) == PAGE

    def _long_poll(self) -> bool:
        self._page(WAIT_S)
        return True

    def _stream(self) -> bool:
        headers = {"Accept": EVENT_STREAM}
        timeout = httpx.Timeout(30.0, read=SILENCE_S)
        with self.http.stream("GET", STREAM, params=self._parameters(), headers=headers, timeout=timeout) as response:
            if response.status_code in {HTTPStatus.NOT_FOUND, HTTPStatus.METHOD_NOT_ALLOWED, HTTPStatus.NOT_ACCEPTABLE}:
                self._silent_streams = STREAM_FAILURES  # an older service, or something between that knows no streams
                return True
            if response.is_error or not response.headers.get("content-type", "").startswith(EVENT_STREAM):
                response.read()
                _checked(response)
                raise RefusedError("the answer is no stream: is this address the service's?")
            self._silent_streams += 1
            for block in blocks(response.iter_lines()):
                self._silent_streams = 0
                self._delays.succeeded()
                if block.identity is not None:
                    if block.data is None:
                        self.taker.moved(block.identity)
                    else:
                        self.taker.event(orjson.loads(block.data), block.identity)
                    self.cursor = block.identity
        return True

    def _open_now(self) -> list[Event]:
        """Return the alerts that are open: what a client holds and is not among them is to be dropped."""
        events: list[Event] = []
        path: str | None = "/v1/alerts?open=true&limit=1000"
        while path is not None:
            page = _checked(self.http.get(path))
            events += page["items"]
            path = page["next"]
        return events


LONGEST_CURSOR = 4096


def read_state(file: Path | None) -> str | None:
    """Return the cursor that an earlier call kept; None where there is none."""
    if file is None or not file.exists():
        return None
    try:
        text = file.read_text(encoding="ascii").strip()
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"cannot be read: {error}", file=str(file)) from None
    if not text or len(text) > LONGEST_CURSOR or not text.replace("-", "").replace("_", "").isalnum():
        raise InputError("holds no cursor of the feed; name another file, or remove it to begin again", file=str(file))
    return text


@dataclass(slots=True)
class Lines:
    """Prints events, for people or as JSON, and keeps the cursor behind them in a file; ``state`` None keeps none."""

    as_json: bool
    state: Path | None
    output: TextIO = sys.stdout
    errors: TextIO = sys.stderr
    _kept: str | None = None

    def event(self, event: Event, cursor: str) -> None:
        """Print an event, then keep its cursor."""
        self._print(orjson.dumps(event).decode() if self.as_json else readable(event))
        self.moved(cursor)

    def moved(self, cursor: str) -> None:
        """Keep a cursor."""
        if self.state is not None and cursor and cursor != self._kept:
            write_atomically(self.state, cursor.encode("ascii") + b"\n", durable=True)
            self._kept = cursor

    def restored(self, reason: str, open_now: Sequence[Event], cursor: str | None) -> None:
        """Say that what follows is another history, and what is open now in it."""
        identities = [alert["id"] for alert in open_now]
        if self.as_json:
            self._print(orjson.dumps({"event": "restored", "detail": reason, "open_alerts": identities}).decode())
        else:
            listed = ", ".join(map(str, identities)) or "none"
            self._print(f"restored: {reason}; alerts open now: {listed}")
        self.moved(cursor or "")

    def waiting(self, reason: str) -> None:
        """Say on the side why nothing comes."""
        print(f"treadwatch: {reason}", file=self.errors, flush=True)

    def _print(self, line: str) -> None:
        print(line, file=self.output, flush=True)


def readable(event: Event) -> str:
    """Return the line of an event for people, with control characters shown and not sent."""
    alert = event["alert"]
    subject = alert["wheelset"] or f"fleet {alert['fleet']}"
    line = f"{event['recorded_at']}  {event['event']:<12}  {alert['id']:>6}  {alert['severity']:<8}  {alert['kind']}"
    line = f"{line}  {subject}" + (f"  by {event['actor']}" if event["actor"] != "treadwatch" else "")
    line += f"  {event['note']}" if event["note"] else ""
    return "".join(character if character.isprintable() else repr(character)[1:-1] for character in line)
