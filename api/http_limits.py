"""What one client may take of the HTTP service: time, connections, size."""

from __future__ import annotations

import resource
from dataclasses import dataclass

from api.settings import Settings

MAX_BODY_BYTES = 1 << 20
MAX_HEAD_BYTES = 16 << 10
"""Request line and headers of one request."""
REQUESTS = 100
"""Requests that are answered at the same time; beyond, 503."""
SEND_TIMEOUT_S = 30.0
"""How long a client may leave an answer unread, in seconds."""
ACCEPTED_AT_ONCE = 8
"""Connections that are accepted in one turn of the event loop; those they displace are closed a few turns later."""
RESERVED_DESCRIPTORS = 64 + 5 * ACCEPTED_AT_ONCE
"""For the database, the data folder, the log, the server itself, and connections that are being closed."""


@dataclass(frozen=True, slots=True)
class HttpLimits:
    """What a request may take: time until its body is there and until it is answered, size of the body.

    ``streams`` is how many clients may wait for news, with a stream or a long poll.
    """

    body_timeout_s: float = 30.0
    request_timeout_s: float = 60.0
    max_body_bytes: int = MAX_BODY_BYTES
    streams: int = 500


def limits_of(settings: Settings) -> HttpLimits:
    """Return the limits that a deployment sets."""
    return HttpLimits(
        settings.body_timeout_s, settings.request_timeout_s, settings.max_body_kb << 10, settings.max_streams
    )


def open_connections(wanted: int) -> int:
    """Return how many connections may be open: ``wanted``, or fewer where the process may open fewer files."""
    descriptors, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    if descriptors == resource.RLIM_INFINITY:
        return wanted
    return max(1, min(wanted, descriptors - RESERVED_DESCRIPTORS))
