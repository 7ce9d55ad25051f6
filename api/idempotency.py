"""Repeated POSTs: the first answer is sent again, and nothing is done twice."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from http import HTTPStatus

import orjson
from fastapi import Request, Response
from pydantic import BaseModel

from api.access.caller import known_caller
from api.answers import answer_bytes, payload_of
from api.problems import ProblemError
from fleet_db.storage import SqlUnitOfWork


@dataclass(frozen=True, slots=True)
class IdempotentPost:
    """One POST with its key; without a key every request is a new one."""

    key: str | None
    request_digest: str

    def earlier(self, request: Request, unit: SqlUnitOfWork) -> Response | None:
        """Return the answer that was already given under this key."""
        known = None if self.key is None else unit.idempotency.get(self.key)
        if known is None:
            return None
        digest, status, body = known
        if digest != self.request_digest:
            detail = "this Idempotency-Key was used for another request; use a new one"
            raise ProblemError(422, "idempotency-key-reused", detail)
        headers = {"Idempotency-Replayed": "true"}
        if status == HTTPStatus.ACCEPTED:
            headers["Location"] = orjson.loads(body)["links"]["self"]
        return answer_bytes(request, body.encode(), status=status, headers=headers)

    def remember(self, unit: SqlUnitOfWork, status: int, body: BaseModel, now_ns: int) -> None:
        """Keep the answer, in the transaction of the change itself."""
        if self.key is not None:
            unit.idempotency.put(self.key, self.request_digest, status, payload_of(body).decode(), now_ns)


def idempotent_post(request: Request, key: str | None, body: BaseModel | None = None) -> IdempotentPost:
    """Return this POST's identity: its key, and a digest of what it asks for."""
    request_parts = [request.method, request.scope["path"], None if body is None else body.model_dump(mode="json")]
    identity = None if (caller := known_caller(request.scope)) is None else caller.identity
    if key is not None and identity is not None:  # another key's answers are not for this caller
        key = f"{hashlib.sha256(identity.encode()).hexdigest()[:32]} {hashlib.sha256(key.encode()).hexdigest()}"
    return IdempotentPost(key, hashlib.sha256(orjson.dumps(request_parts)).hexdigest())
