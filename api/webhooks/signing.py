"""Signatures of Standard Webhooks (https://www.standardwebhooks.com): HMAC-SHA256 over id, time and body."""

from __future__ import annotations

import base64
import hashlib
import hmac
import secrets
from collections.abc import Mapping, Sequence

PREFIX = "whsec_"
SECRET_BYTES = 32
MEDIA_TYPE = "application/cloudevents+json"
NS = 1_000_000_000


def new_secret() -> str:
    """Return a secret of 32 random bytes, as receivers are given it."""
    return PREFIX + base64.b64encode(secrets.token_bytes(SECRET_BYTES)).decode()


def signature(secret: str, event_id: str, timestamp: int, body: bytes) -> str:
    """Return one signature."""
    key = base64.b64decode(secret.removeprefix(PREFIX), validate=True)
    signed = hmac.new(key, f"{event_id}.{timestamp}.".encode() + body, hashlib.sha256)
    return f"v1,{base64.b64encode(signed.digest()).decode()}"


def signed_headers(secrets_of: Sequence[str], event_id: str, now_ns: int, body: bytes) -> Mapping[str, str]:
    """Return the headers of an event: its media type, and what lets a receiver know that it is ours."""
    if not secrets_of:
        raise ValueError("the webhook has no secret")
    timestamp = now_ns // NS
    return {
        "Content-Type": MEDIA_TYPE,
        "webhook-id": event_id,
        "webhook-timestamp": str(timestamp),
        "webhook-signature": " ".join(signature(one, event_id, timestamp, body) for one in secrets_of),
    }
