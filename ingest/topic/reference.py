"""A reference to a chunk, its form on the topic (key ``fleet:vehicle``, a small JSON object), and what became of it."""

from __future__ import annotations

import threading
from collections import Counter
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from enum import StrEnum
from typing import Annotated

import orjson
from pydantic import AwareDatetime, BaseModel, ConfigDict, Field, ValidationError

from fleet_db.receipts import ChunkRecord
from ingest.logs.formats import SUFFIXES


class Outcome(StrEnum):
    """What became of a message, once its offset is committed."""

    STORED = "stored"  # the receipt is new: the bytes were in the raw store already
    KNOWN = "known"  # there was a receipt
    MISSING = "missing"  # no such bytes in the raw store: in quarantine, tried again
    DAMAGED = "damaged"  # other bytes under that digest, or of another size: in quarantine, tried again
    FAILED = "failed"  # the program failed at it: in quarantine, tried again
    OTHER_VEHICLE = "other_vehicle"  # the same chunk was received from another vehicle
    DELETED = "deleted"  # the chunk was deleted by hand
    MALFORMED = "malformed"
    OTHER_VERSION = "other_version"
    CONTRADICTORY = "contradictory"  # key and body name different vehicles


@dataclass(frozen=True, slots=True)
class Refused:
    """A message of which nothing is taken: what it counts as, and why in a sentence."""

    outcome: Outcome
    text: str


VERSION = 1
MOST_BYTES = 4096  # of the value of a message; what is larger is no reference
MOST_NAME_LETTERS = 255
SHOWN = 200  # letters of what is wrong with a message that the log shows
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_PRINTABLE = r"^[^\x00-\x1f\x7f]+$"


@dataclass(frozen=True, slots=True)
class Reference:
    """What a message says of a chunk."""

    digest: str
    suffix: str
    vehicle: str
    size_bytes: int
    file_name: str
    received_ns: int  # when it was received, ns UTC of the clock of whoever published the reference


class _Body(BaseModel):
    """Fields that a later minor release adds are ignored."""

    model_config = ConfigDict(strict=True, extra="ignore", frozen=True)

    sha256: Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
    format: Annotated[str, Field(pattern=r"^[a-z0-9]{1,8}$")]
    vehicle: Annotated[str, Field(pattern=_PRINTABLE, max_length=64)]
    size_bytes: Annotated[int, Field(ge=1, lt=1 << 63)]
    file_name: Annotated[str, Field(pattern=_PRINTABLE, max_length=MOST_NAME_LETTERS)]
    received_at: AwareDatetime


def reference_of(record: ChunkRecord) -> Reference | None:
    """Return the reference to a received chunk; None where it is no log, which no other place could take."""
    if record.suffix not in SUFFIXES:
        return None
    name = (record.file_name or f"{record.digest}{record.suffix}")[-MOST_NAME_LETTERS:]
    return Reference(record.digest, record.suffix, record.vehicle, record.size_bytes, name, record.received_ns)


def message_of(reference: Reference, fleet: str) -> tuple[bytes, bytes]:
    """Return key and value of the message of a reference; the fleet is empty where the vehicle is not registered."""
    body = {
        "version": VERSION,
        "sha256": reference.digest,
        "format": reference.suffix.removeprefix("."),
        "vehicle": reference.vehicle,
        "size_bytes": reference.size_bytes,
        "file_name": reference.file_name,
        "received_at": (_EPOCH + timedelta(microseconds=reference.received_ns // 1000)).isoformat(),
    }
    return f"{fleet}:{reference.vehicle}".encode(), orjson.dumps(body)


def read_message(key: bytes | None, value: bytes | None) -> Reference | Refused:
    """Return the reference of a message, or why there is none."""
    if value is None or len(value) > MOST_BYTES:
        size = "no value" if value is None else f"{len(value):,} bytes, a reference has at most {MOST_BYTES:,}"
        return Refused(Outcome.MALFORMED, f"has {size}")
    try:
        found = orjson.loads(value)
    except orjson.JSONDecodeError as error:
        return Refused(Outcome.MALFORMED, f"is no JSON: {error}"[:SHOWN])
    version = found.get("version") if isinstance(found, dict) else None
    if type(version) is not int:
        return Refused(Outcome.MALFORMED, "is no object with a version")
    if version != VERSION:
        return Refused(Outcome.OTHER_VERSION, f"is of version {version}, this release reads version {VERSION}"[:SHOWN])
    try:
        body = _Body.model_validate_json(value)
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False, include_context=False)[0]
        place = ".".join(str(part) for part in first["loc"])
        return Refused(Outcome.MALFORMED, f"{place}: {first['msg']}"[:SHOWN])
    return _of_its_key(key, body)


def as_text(reference: Reference) -> str:
    """Return a reference as it is kept in quarantine."""
    return message_of(reference, "")[1].decode()


def from_text(text: str) -> Reference | None:
    """Return the reference that was kept in quarantine; None where a later release wrote another version of it."""
    read = read_message(None, text.encode())
    return read if isinstance(read, Reference) else None


def _of_its_key(key: bytes | None, body: _Body) -> Reference | Refused:
    named = None if key is None else key.decode(errors="replace")
    if named is not None and not named.endswith(f":{body.vehicle}"):
        text = f"has the key {named[:SHOWN]!r} and names vehicle {body.vehicle!r}"
        return Refused(Outcome.CONTRADICTORY, text)
    suffix = f".{body.format}"
    if suffix not in SUFFIXES:
        return Refused(Outcome.MALFORMED, f"has the format {body.format!r}, none of {', '.join(SUFFIXES)}")
    received_ns = (body.received_at - _EPOCH) // timedelta(microseconds=1) * 1000
    return Reference(body.sha256, suffix, body.vehicle, body.size_bytes, body.file_name, received_ns)


@dataclass(slots=True)
class ConsumerStatus:
    """What a consumer knows; written by its thread, and read by any. Counts are since the start; no fault is None."""

    broker_fault: str | None = "not asked yet"
    raw_fault: str | None = None
    database_fault: str | None = "not asked yet"
    behind: str | None = None  # which limit keeps new receipts out
    outcomes: Counter[Outcome] = field(default_factory=Counter)  # of messages
    decoded: int = 0  # chunks
    not_decoded: int = 0  # chunks that could not be
    partitions: int = 0  # this consumer's
    behind_by: int = 0  # messages of these that are not taken yet, as far as the brokers have said
    last_message_s: float | None = None  # seconds since the Unix epoch; None before the first
    last_age_s: float = 0.0  # of the reference of the last message, when it was taken
    thread: threading.Thread | None = None

    @property
    def alive(self) -> bool:
        """Whether its thread runs."""
        return self.thread is not None and self.thread.is_alive()

    @property
    def faults(self) -> dict[str, str]:
        """What keeps references from their receipts, by where it is."""
        found = {"broker": self.broker_fault, "raw": self.raw_fault, "database": self.database_fault}
        return {where: fault for where, fault in found.items() if fault is not None}
