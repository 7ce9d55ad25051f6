"""Objects of one bucket of an S3-compatible store, with our faults: no secret in any of them, and bounded times."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import timedelta
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

from estimation.errors import PassingFaultError
from estimation.values.reasons import ReasonCode

if TYPE_CHECKING:
    from obstore import GetOptions, ObjectMeta
    from obstore.store import S3Credential, S3Store

EXTRA = "treadwatch[s3]"
PART_BYTES = 5 << 20
"""Objects up to this size are sent and read by one request; larger ones in parts of it."""
CONNECT_S = 5.0
RETRIES = 3
FIRST_PAUSE_S, LONGEST_PAUSE_S = 0.1, 2.0
_STATUS = re.compile(r"status code: (\d{3}(?: [A-Z][A-Za-z-]*)*)")
_CODE = re.compile(r"<Code>([A-Za-z0-9]{1,60})</Code>")
NO_BUCKET = "NoSuchBucket"


@dataclass(frozen=True, slots=True)
class S3Place:
    """Where a bucket is."""

    bucket: str
    prefix: str  # of the objects; may be empty
    endpoint: str
    region: str
    allow_http: bool  # whether the connection may go without TLS
    timeout_s: float  # how long one request may take; with its repetitions, at most twice as long
    # access_key_id, secret_access_key, maybe token; None where the client library finds credentials by a role
    keys: Mapping[str, str] | None = field(default=None, repr=False)

    @property
    def url(self) -> str:
        """Of the objects, without any secret."""
        return f"s3://{self.bucket}/{self.prefix}".rstrip("/")


@dataclass(frozen=True, slots=True)
class ObjectFacts:
    """Size in bytes, ETag without quotes (empty where there is none), and when it was written, s since the epoch."""

    size_bytes: int
    e_tag: str
    changed_s: float


class S3Bucket:
    """Objects below the prefix of a place, whose bucket must be there already."""

    def __init__(self, place: S3Place) -> None:
        self.place = place
        self._store = _opened(place)

    def url(self, name: str) -> str:
        """Return where an object is, for messages."""
        return f"{self.place.url}/{name}"

    def facts(self, name: str) -> ObjectFacts | None:
        """Return what the store says of an object; None where it is not there. Raises PassingFaultError."""
        with self._faults(name):
            try:
                return _facts(self._store.head(name))
            except FileNotFoundError:
                return None

    def pieces(self, name: str, facts: ObjectFacts) -> Iterator[bytes]:
        """Yield the bytes of an object of which the store has said this, by bounded requests.

        Raises FileNotFoundError, and PassingFaultError where it cannot be read now, or has been replaced meanwhile.
        """
        for first in range(0, facts.size_bytes, PART_BYTES):
            yield self._part(name, first, min(first + PART_BYTES, facts.size_bytes), facts.e_tag)

    def put(self, name: str, content: Path | bytes) -> None:
        """Put a file or a few bytes, whole or not at all; large ones in parts. Raises PassingFaultError."""
        large = isinstance(content, Path) and content.stat().st_size > PART_BYTES
        with self._faults(name):
            try:
                self._store.put(name, content, use_multipart=large, chunk_size=PART_BYTES, max_concurrency=1)
            except FileNotFoundError as error:
                self._refuse(name, error)

    def read_few(self, name: str, most_bytes: int) -> bytes | None:
        """Return the first bytes of a small object; None where it is not there. Raises PassingFaultError."""
        with self._faults(name):
            try:
                return bytes(self._store.get(name, options={"range": (0, most_bytes)}).bytes())
            except FileNotFoundError as error:
                if NO_BUCKET in str(error):
                    self._refuse(name, error)
                return None

    def remove(self, name: str) -> None:
        """Remove an object; one that is not there is removed already. Raises PassingFaultError."""
        with self._faults(name):
            try:
                self._store.delete(name)
            except FileNotFoundError as error:
                if NO_BUCKET in str(error):
                    self._refuse(name, error)

    def listed(self) -> Iterator[tuple[str, ObjectFacts]]:
        """Yield name and facts of every object, a thousand a request. Raises PassingFaultError."""
        with self._faults(""):
            pages = iter(self._store.list(chunk_size=1000))
        while True:
            with self._faults(""):
                page = next(pages, None)
            if page is None:
                return
            for meta in page:
                yield meta["path"], _facts(meta)

    def _part(self, name: str, first: int, end: int, e_tag: str) -> bytes:
        options: GetOptions = {"range": (first, end)}
        if e_tag:
            options["if_match"] = f'"{e_tag}"'
        with self._faults(name):
            got = bytes(self._store.get(name, options=options).bytes())
        if len(got) != end - first:
            raise PassingFaultError(f"ended after {len(got)} of {end - first} bytes", file=self.url(name))
        return got

    @contextmanager
    def _faults(self, name: str) -> Iterator[None]:
        """Turn errors of the client library into ours; of its text only status and code come along."""
        from obstore.exceptions import BaseError  # noqa: PLC0415 - of the extra

        try:
            yield
        except BaseError as error:
            self._refuse(name, error)

    def _refuse(self, name: str, error: Exception) -> NoReturn:
        raise PassingFaultError(_reason(error, self.place), file=self.url(name)) from None


def _opened(place: S3Place) -> S3Store:
    try:
        from obstore.store import S3Store  # noqa: PLC0415 - of the extra
    except ImportError as error:
        reason = f"a store of s3:// needs the extra 's3': pip install '{EXTRA}'"
        raise PassingFaultError(reason, code=ReasonCode.WAITS_FOR_EXTRA) from error
    time_s = timedelta(seconds=place.timeout_s)
    keys = place.keys
    provider = None if keys is None else (lambda: _credential(keys))
    return S3Store(
        place.bucket,
        prefix=place.prefix or None,
        # given here, so that no other variable of the environment decides
        endpoint=place.endpoint,
        aws_endpoint_url_s3=place.endpoint,
        region=place.region,
        checksum_algorithm="SHA256",
        virtual_hosted_style_request=False,
        unsigned_payload=False,
        skip_signature=False,
        disable_bulk_delete=True,
        credential_provider=provider,
        client_options={
            "allow_http": place.allow_http,
            "connect_timeout": timedelta(seconds=min(CONNECT_S, place.timeout_s)),
            "timeout": time_s,
        },
        retry_config={
            "max_retries": RETRIES,
            "retry_timeout": time_s,
            "backoff": {
                "init_backoff": timedelta(seconds=FIRST_PAUSE_S),
                "max_backoff": timedelta(seconds=LONGEST_PAUSE_S),
                "base": 2,
            },
        },
    )


def _credential(keys: Mapping[str, str]) -> S3Credential:
    return {
        "access_key_id": keys["access_key_id"],
        "secret_access_key": keys["secret_access_key"],
        "token": keys.get("token"),
        "expires_at": None,
    }


def _facts(meta: ObjectMeta) -> ObjectFacts:
    return ObjectFacts(meta["size"], (meta["e_tag"] or "").strip('"'), meta["last_modified"].timestamp())


def _reason(error: Exception, place: S3Place) -> str:
    """Return what the store answered, in a few words that cannot hold a secret."""
    text = str(error)
    status, code = _STATUS.search(text), _CODE.search(text)
    if status is None:
        late = "time" in text and ("TimedOut" in text or "timed out" in text)
        return f"{place.endpoint} {f'does not answer within {place.timeout_s:g} s' if late else 'cannot be reached'}"
    return f"{place.endpoint} answers {status[1]}{f' ({code[1]})' if code else ''}"
