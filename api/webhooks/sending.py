"""One attempt to hand a body to a receiver: to a checked address, within a time, without following where it points.

A webhook makes the service send where somebody else says, so it must not lead to what only the service can reach: the
machine itself, its network, the metadata of its cloud. The addresses of its name are looked up and checked each time.
"""

from __future__ import annotations

import asyncio
import ipaddress
import re
import socket
import ssl
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from http import HTTPStatus
from importlib.metadata import version

import httpx

from api.settings import Settings
from estimation.errors import ParameterError
from fleet_db.records import Failure

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
    allowed = [any(_plain(address) in network for network in networks) for address in addresses]
    if not all(is_allowed or is_public(address) for is_allowed, address in zip(allowed, addresses, strict=True)):
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
    parts = [part.strip() for part in (setting or "").split(",")]
    try:
        return tuple(ipaddress.ip_network(part) for part in parts if part)
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
            addresses = await loop.run_in_executor(self._threads, _look_up, url.raw_host.decode("ascii"), port)
        except (OSError, UnicodeError):
            raise RefusedTargetError(Failure.UNKNOWN_HOST, "the host has no address") from None
        check(url, addresses, self.networks)
        return Target(url, tuple(addresses))


def _look_up(host: str, port: int) -> list[Address]:
    entries = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)
    return list(dict.fromkeys(ipaddress.ip_address(str(entry[4][0]).partition("%")[0]) for entry in entries))


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


MOST_ANSWER_BYTES = 65_536  # what is read of an answer, which is then let go; a receiver that says more is cut off
ADDRESSES = 4  # addresses of a name that are tried, one after the other
TRIALS = 4  # webhooks that are tried out at once in a process
LOOK_UP_S = 5.0  # how long the addresses of a name are waited for where nothing is sent
ANSWER_S = 1.0  # how long what follows the status of an answer is waited for; it decides nothing


@dataclass(frozen=True, slots=True)
class Outcome:
    """What came back.

    Args:
        failure, detail: Why the event was not taken, as code and sentence; None where it was.
    """

    status_code: int | None
    failure: Failure | None
    detail: str | None
    retry_after: str | None
    took_s: float


@dataclass(frozen=True)
class Sender:
    """Sends to receivers."""

    targets: Targets
    timeout_s: float = 15.0

    @cached_property
    def _certificates(self) -> ssl.SSLContext:
        return httpx.create_ssl_context()  # of the package, or those of SSL_CERT_FILE or SSL_CERT_DIR

    async def send(self, url: str, headers: Mapping[str, str], body: bytes) -> Outcome:
        """Return what came back of one attempt; it never raises for what a receiver does."""
        began_s = time.monotonic()
        status: int | None = None
        retry_after: str | None = None
        try:
            async with asyncio.timeout(self.timeout_s):
                target = await self.targets.look_up(url)
                status, retry_after = await self._post(target, headers, body)
            failure, detail = judged(status)
        except TimeoutError:
            failure, detail = Failure.TIMEOUT, f"no answer within {self.timeout_s:g} s"
        except RefusedTargetError as error:
            failure, detail = error.failure, error.detail
        except ParameterError as error:
            failure, detail = Failure.REFUSED_ADDRESS, f"the URL {error.reason}"
        except httpx.ConnectError as error:
            failure, detail = _not_connected(error)
        except httpx.TimeoutException:
            failure, detail = Failure.TIMEOUT, f"no answer within {self.timeout_s:g} s"
        except httpx.HTTPError:
            failure, detail = Failure.NO_HTTP, "the connection ended without an answer in HTTP"
        return Outcome(status, failure, detail, retry_after, time.monotonic() - began_s)

    async def look_up(self, url: str) -> Target:
        """Return where a URL leads now, for who wants to know it before anything is sent."""
        try:
            async with asyncio.timeout(LOOK_UP_S):
                return await self.targets.look_up(url)
        except TimeoutError:
            raise RefusedTargetError(Failure.UNKNOWN_HOST, "no name server answers") from None

    async def _post(self, target: Target, headers: Mapping[str, str], body: bytes) -> tuple[int, str | None]:
        """Return status and ``Retry-After`` of the answer at the first address that accepts a connection."""
        *others, last = target.addresses[:ADDRESSES]
        # one that swallows what it is sent leaves the next ones their time
        limits = httpx.Timeout(self.timeout_s, connect=self.timeout_s / (len(others) + 1))
        for address in others:
            with suppress(httpx.ConnectError, httpx.ConnectTimeout):
                return await self._post_to(address, target.url, headers, body, limits)
        return await self._post_to(last, target.url, headers, body, limits)

    async def _post_to(
        self, address: Address, url: httpx.URL, headers: Mapping[str, str], body: bytes, limits: httpx.Timeout
    ) -> tuple[int, str | None]:
        """Post to one address under the name of the URL, which the certificate must be for."""
        named = {"Host": url.netloc.decode("ascii"), "User-Agent": f"treadwatch/{version('treadwatch')}"}
        named |= {"Accept": "*/*", "Accept-Encoding": "identity"}
        # a client of its own: a connection that is kept open would be that of another name at the same address
        async with httpx.AsyncClient(
            verify=self._certificates, trust_env=False, follow_redirects=False, timeout=limits
        ) as client:
            name = url.raw_host.decode("ascii")
            request = client.build_request(
                "POST",
                url.copy_with(host=str(address)),
                headers={**headers, **named},
                content=body,
                extensions={"sni_hostname": name},
            )
            response = await client.send(request, stream=True)
            try:
                await _read_a_little(response)
            finally:
                await response.aclose()
            return response.status_code, response.headers.get("retry-after")


def sender_of(settings: Settings) -> Sender:
    """Return what sends to the webhooks of a deployment."""
    return Sender(Targets(networks_of(settings.webhook_networks)), settings.webhook_timeout_s)


async def _read_a_little(response: httpx.Response) -> None:
    """Take what a receiver says after the status, so that it need not fail at saying it."""
    count = 0
    with suppress(TimeoutError, httpx.HTTPError):
        async with asyncio.timeout(ANSWER_S):
            async for part in response.aiter_raw():
                count += len(part)
                if count >= MOST_ANSWER_BYTES:
                    return


def judged(status: int) -> tuple[Failure | None, str | None]:
    """Return what the status of an answer means: why the event was not taken, or nothing where it was."""
    if HTTPStatus.OK <= status < HTTPStatus.MULTIPLE_CHOICES:
        return None, None
    if status == HTTPStatus.GONE:
        return Failure.GONE, "the receiver answered 410: it wants nothing more"
    if HTTPStatus.MULTIPLE_CHOICES <= status < HTTPStatus.BAD_REQUEST:
        return Failure.REDIRECT, f"the receiver answered {status}: redirects are not followed, change the URL"
    return Failure.STATUS, f"the receiver answered {status}"


def _not_connected(error: httpx.ConnectError) -> tuple[Failure, str]:
    """Return why there is no connection; the words of the certificate's check are ours to show."""
    cause: BaseException | None = error
    while cause is not None:
        if isinstance(cause, ssl.SSLCertVerificationError):
            return Failure.TLS, f"the certificate is refused: {cause.verify_message}"
        if isinstance(cause, ssl.SSLError):
            return Failure.TLS, "the receiver does not speak TLS as it should"
        cause = cause.__cause__ or cause.__context__
    return Failure.UNREACHABLE, "no connection to the receiver"
