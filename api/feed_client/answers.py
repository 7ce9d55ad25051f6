"""Answers of the service as a client understands them: pages, blocks of a stream, and refusals."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from http import HTTPStatus
from typing import Any

import httpx
import orjson

from estimation.errors import TreadwatchError

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
    """Yield the blocks of a stream (WHATWG HTML, 9.2.6); one that ends in the middle is dropped.

    Args:
        lines: Without their ends.
    """
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


def checked(response: httpx.Response) -> Any:  # noqa: ANN401 - JSON
    """Return the body of a success.

    Args:
        response: Read to its end.

    Raises:
        OtherHistoryError: 409: the cursor is of another history.
        RefusedError: The request is wrong, or not allowed.
        UnreachableError: The service has too much to do, or failed.
    """
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
