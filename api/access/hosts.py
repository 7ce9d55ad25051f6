"""Under which names the service is reached, and pages of which origins may change something.

A page of a foreign site can make its reader's browser send requests here. Its origin is in them; and where it had its
own name resolved to our address, that name is in ``Host``.
"""

from __future__ import annotations

from dataclasses import dataclass
from http import HTTPMethod
from urllib.parse import urlsplit

from starlette.datastructures import Headers
from starlette.types import Scope

from api.problems import ProblemError

LOOPBACK_NAMES = frozenset({"localhost", "127.0.0.1", "::1"})
READING = frozenset({HTTPMethod.GET, HTTPMethod.HEAD, HTTPMethod.OPTIONS})


@dataclass(frozen=True, slots=True)
class Hosts:
    """The names and origins that are let through.

    Args:
        names: Names of hosts, in lower case, beside those of loopback and the address that the connection came in at.
        origins: Origins of pages, such as ``https://maintenance.example``, beside our own.
    """

    names: frozenset[str] = frozenset()
    origins: frozenset[str] = frozenset()

    def check(self, scope: Scope) -> None:
        """Refuse a request under another name, or a change that a page of another origin asks for.

        Raises:
            ProblemError: 421 or 403.
        """
        headers = Headers(scope=scope)
        host = headers.get("host")
        if host is not None and not self._ours(host, scope):
            detail = "the service is not reached under this name; name it in TREADWATCH_HOSTS"
            raise ProblemError(421, "unknown-host", detail)
        origin = headers.get("origin")
        if origin is None or scope["method"] in READING or origin in self.origins:
            return
        if host is None or urlsplit(origin).netloc.lower() != host.lower():
            detail = "pages of another origin may not change anything here; name it in TREADWATCH_ORIGINS"
            raise ProblemError(403, "foreign-origin", detail)

    def _ours(self, host: str, scope: Scope) -> bool:
        name = host_name(host)
        here = scope.get("server")
        return name in LOOPBACK_NAMES or name in self.names or (here is not None and name == str(here[0]).lower())


def host_name(host: str) -> str | None:
    """Return the name in a ``Host`` header, in lower case and without its port; None where it is none."""
    try:
        parts = urlsplit(f"//{host}")
        _ = parts.port
    except ValueError:
        return None
    return parts.hostname.rstrip(".") if parts.hostname and parts.netloc == host and "@" not in host else None
