"""From settings to a gate: what of a deployment concerns access, checked before anything listens."""

from __future__ import annotations

import ipaddress
from collections.abc import Callable
from dataclasses import dataclass, field

from api.access.book import AccessBook
from api.access.gate import Gate, Hosts, Opened
from api.access.key_ring import KeyRing
from api.access.oidc import Provider, Tokens
from api.access.rates import Rate
from api.settings import PREFIX, Settings
from estimation.errors import ParameterError
from fleet_db.storage import SqlStorage

IN_WORDS = "open to everyone who reaches this address"
MINUTE_S = 60.0


@dataclass(frozen=True, slots=True)
class AccessPlan:
    """What a deployment has decided; the default needs keys."""

    with_keys: bool = True
    hosts: Hosts = field(default_factory=Hosts)
    doors: Opened = field(default_factory=Opened)
    provider: Provider | None = None
    requests_per_s: float = 50.0
    requests_burst: int = 500
    failed_keys_per_minute: float = 10.0
    streams_per_key: int = 10
    https: bool = False

    def gate(self, storage: Callable[[], SqlStorage], book: AccessBook) -> Gate:
        """Return the gate of one app."""
        return Gate(
            hosts=self.hosts,
            doors=self.doors,
            keys=KeyRing(storage) if self.with_keys else None,
            tokens=None if self.provider is None else Tokens(self.provider),
            uses=book,
            requests=Rate(self.requests_per_s, self.requests_burst),
            failures=Rate(self.failed_keys_per_minute / MINUTE_S, max(1.0, self.failed_keys_per_minute)),
        )


def plan_of(settings: Settings) -> AccessPlan:
    """Return what a deployment has decided.

    Raises:
        ParameterError: Access is open beyond loopback and nothing says that this is meant; or the settings of the token
            issuer are not complete.
    """
    if settings.access == "open" and not is_loopback(settings.host):
        raise ParameterError(
            f"is open, and {settings.host} is reached from beyond this machine: use keys, or say '{IN_WORDS}'",
            field=f"{PREFIX}ACCESS",
        )
    return AccessPlan(
        with_keys=settings.access == "keys",
        hosts=Hosts(
            frozenset(name.lower() for name in listed(settings.hosts)),
            frozenset(origin.rstrip("/").lower() for origin in listed(settings.origins)),
        ),
        doors=Opened(settings.metrics, settings.docs),
        provider=_provider(settings),
        requests_per_s=settings.requests_per_s,
        requests_burst=settings.requests_burst,
        failed_keys_per_minute=settings.failed_keys_per_minute,
        streams_per_key=settings.streams_per_key,
        https=settings.https,
    )


def is_loopback(host: str) -> bool:
    """Return whether an address to listen on is reached from this machine alone."""
    try:
        return ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return host.lower() == "localhost"


def listed(value: str | None) -> list[str]:
    """Return the parts of a setting with commas between them."""
    return [part for one in (value or "").split(",") if (part := one.strip())]


def _provider(settings: Settings) -> Provider | None:
    needed = {"issuer": settings.oidc_issuer, "audience": settings.oidc_audience, "keys": settings.oidc_keys}
    if not any(needed.values()):
        return None
    for name, value in needed.items():
        if value is None:
            others = ", ".join(f"{PREFIX}OIDC_{other.upper()}" for other in needed if other != name)
            raise ParameterError(f"is needed with {others}", field=f"{PREFIX}OIDC_{name.upper()}")
    return Provider(
        issuer=str(settings.oidc_issuer),
        audience=str(settings.oidc_audience),
        keys=str(settings.oidc_keys),
        owner_claim=settings.oidc_owner_claim,
        scopes_claim=settings.oidc_scopes_claim,
        fleets_claim=settings.oidc_fleets_claim,
        leeway_s=settings.oidc_leeway_s,
    )
