"""One attempt to hand a body to a receiver: to a checked address, within a time, without following where it points."""

from __future__ import annotations

import asyncio
import ssl
import time
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from http import HTTPStatus
from importlib.metadata import version

import httpx

from api.settings import Settings
from api.webhooks.targets import Address, RefusedTargetError, Target, Targets, networks_of
from estimation.errors import ParameterError
from fleet_db.webhook_records import Failure

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
