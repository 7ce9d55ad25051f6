"""Where a webhook may lead: which addresses its name has is looked up when something is sent, and each is checked.

A webhook makes the service send where somebody else says, so it must not lead to what only the service can reach: the
machine itself, its network, the metadata of its cloud.
"""

from __future__ import annotations

import asyncio
import ipaddress
import re
import socket
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field

import httpx

from estimation.errors import ParameterError
from fleet_db.webhook_records import Failure

Address = ipaddress.IPv4Address | ipaddress.IPv6Address
Network = ipaddress.IPv4Network | ipaddress.IPv6Network
MOST_CHARACTERS = 2000
LOOK_UPS = 16  # names that are looked up at once
SETTING = "TREADWATCH_WEBHOOK_NETWORKS"
_HOST_NAME = re.compile(r"[a-z0-9_]([a-z0-9_.-]{0,251}[a-z0-9_.])?", re.ASCII)
_PORTS = {"https": 443, "http": 80}
_FIRST_FREE_PORT, _LAST_PORT = 1024, 65_535
_NAT64 = ipaddress.IPv6Network("64:ff9b::/96")
_UNICAST = ipaddress.IPv6Network("2000::/3")
# addresses that the registries call global, and that lead to a machine's own surroundings
_NEVER = tuple(
    ipaddress.ip_network(text)
    for text in (
        "168.63.129.16/32",  # the host of a virtual machine at Azure
        "192.0.0.0/24",  # protocol assignments
        "192.88.99.0/24",  # relays of 6to4
        "2001::/23",  # protocol assignments, Teredo among them
        "2002::/16",  # 6to4, which carries any address of IPv4
    )
)


class RefusedTargetError(Exception):
    """A webhook leads where nothing may be sent, or nowhere; ``failure`` is the code."""

    def __init__(self, failure: Failure, detail: str) -> None:
        self.failure = failure
        self.detail = detail
        super().__init__(detail)


@dataclass(frozen=True, slots=True)
class Target:
    """A URL, and the addresses of its host, all of them checked."""

    url: httpx.URL
    addresses: tuple[Address, ...]


def parsed(text: str) -> httpx.URL:
    """Return a URL to which a webhook may lead, as far as that can be read from it."""
    try:
        url = httpx.URL(text)
    except (httpx.InvalidURL, ValueError):
        raise _refused("is no URL") from None
    host = url.raw_host.decode("ascii", "replace")
    if len(text) > MOST_CHARACTERS or not text.isprintable() or " " in text:
        raise _refused(f"is no URL of at most {MOST_CHARACTERS} characters without spaces")
    if url.scheme not in _PORTS:
        raise _refused("begins neither with https:// nor with http://")
    if url.userinfo or "@" in re.split(r"[/?#]", text.partition("//")[2], maxsplit=1)[0]:
        raise _refused("carries a user or a password")
    if url.fragment:
        raise _refused("has a fragment, which is never sent")
    if not (_HOST_NAME.fullmatch(host.lower()) or _is_address(host)):
        raise _refused("names no host")
    port = _port(url)
    if not (port in _PORTS.values() or _FIRST_FREE_PORT <= port <= _LAST_PORT):
        raise _refused(f"names the port {port}: use 443, 80 or one from {_FIRST_FREE_PORT} on")
    return url


def check(url: httpx.URL, addresses: Sequence[Address], networks: Sequence[Network]) -> None:
    """Refuse a URL one of whose addresses is not public and of no network that is allowed."""
    if not addresses:
        raise RefusedTargetError(Failure.UNKNOWN_HOST, "the host has no address")
    allowed = [any(_plain(one) in network for network in networks) for one in addresses]
    if not all(known or is_public(one) for known, one in zip(allowed, addresses, strict=True)):
        text = f"the host has an address that is not public, in none of the networks of {SETTING}"
        raise RefusedTargetError(Failure.REFUSED_ADDRESS, text)
    if url.scheme == "http" and not all(allowed):
        raise RefusedTargetError(Failure.REFUSED_ADDRESS, f"http:// is for the networks of {SETTING}: use https://")


def is_public(address: Address) -> bool:
    """Return whether an address is of the public network, also where it carries another one."""
    plain = _plain(address)
    if any(plain in network for network in _NEVER) or plain.is_multicast:
        return False
    return plain.is_global and (isinstance(plain, ipaddress.IPv4Address) or plain in _UNICAST)


def networks_of(setting: str | None) -> tuple[Network, ...]:
    """Return the private networks that a deployment allows."""
    parts = [part for one in (setting or "").split(",") if (part := one.strip())]
    try:
        return tuple(ipaddress.ip_network(part) for part in parts)
    except ValueError as error:
        raise ParameterError(f"{error}; write networks such as 10.1.0.0/16", field=SETTING) from None


@dataclass(frozen=True, slots=True)
class Targets:
    """Looks names up, in threads of its own: a slow name server keeps nobody else waiting."""

    networks: tuple[Network, ...] = ()
    _threads: ThreadPoolExecutor = field(default_factory=lambda: ThreadPoolExecutor(LOOK_UPS, "webhook-names"))

    async def look_up(self, text: str) -> Target:
        """Return where a URL leads now; refused (ParameterError, RefusedTargetError) where nothing may be sent."""
        url = parsed(text)
        port = _port(url)
        loop = asyncio.get_running_loop()
        try:
            found = await loop.run_in_executor(self._threads, _look_up, url.raw_host.decode("ascii"), port)
        except (OSError, UnicodeError):
            raise RefusedTargetError(Failure.UNKNOWN_HOST, "the host has no address") from None
        check(url, found, self.networks)
        return Target(url, tuple(found))


def _look_up(host: str, port: int) -> list[Address]:
    found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)
    return list(dict.fromkeys(ipaddress.ip_address(str(entry[4][0]).partition("%")[0]) for entry in found))


def _port(url: httpx.URL) -> int:
    return _PORTS[url.scheme] if url.port is None else url.port


def _plain(address: Address) -> Address:
    """Return the address of IPv4 that one of IPv6 stands for (mapped, or NAT64), else the address itself."""
    if isinstance(address, ipaddress.IPv6Address):
        if address.ipv4_mapped is not None:
            return address.ipv4_mapped
        if address in _NAT64:
            return ipaddress.IPv4Address(address.packed[-4:])
    return address


def _is_address(host: str) -> bool:
    try:
        ipaddress.ip_address(host.strip("[]"))
    except ValueError:
        return False
    return "%" not in host


def _refused(reason: str) -> ParameterError:
    return ParameterError(reason, field="url")
