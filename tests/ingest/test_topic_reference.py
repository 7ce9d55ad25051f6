"""A reference on the topic: what is written is read again, and whatever else comes is refused with a reason."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest

from fleet_db.records import ChunkRecord
from ingest.receipts import Chunk
from ingest.topic.client import Outcome
from ingest.topic.references import (
    MOST_BYTES,
    VERSION,
    Reference,
    Refused,
    as_text,
    from_text,
    message_of,
    read_message,
    reference_of,
)

DIGEST = "ab" * 32
NOW_NS = 1_790_000_000_123_456_789
RECORD: ChunkRecord = Chunk("L-1", ".blf", "L-1__7.blf", None).receipt(DIGEST, 1234, NOW_NS)


def reference() -> Reference:
    found = reference_of(RECORD)
    assert found is not None
    return found


def value(**changes: object) -> bytes:
    """Return the value of a message with changed fields; None takes one away."""
    body = {**json.loads(message_of(reference(), "north")[1]), **changes}
    return json.dumps({name: field for name, field in body.items() if field is not None}).encode()


def test_the_message_of_a_receipt_is_what_the_page_documents() -> None:
    key, written = message_of(reference(), "north")
    assert key == b"north:L-1"
    assert json.loads(written) == {
        "version": 1,
        "sha256": DIGEST,
        "format": "blf",
        "vehicle": "L-1",
        "size_bytes": 1234,
        "file_name": "L-1__7.blf",
        "received_at": "2026-09-21T14:13:20.123456+00:00",
    }
    assert read_message(key, written) == replace(reference(), received_ns=NOW_NS // 1000 * 1000)
    assert read_message(None, written) == read_message(key, written)  # the key only decides the partition
    assert read_message(b":L-1", written) == read_message(key, written)  # a vehicle that is not registered


def test_a_reference_in_quarantine_is_read_again() -> None:
    kept = replace(reference(), received_ns=NOW_NS // 1000 * 1000)
    assert from_text(as_text(kept)) == kept
    assert from_text(as_text(kept).replace(f'"version":{VERSION}', '"version":9')) is None


def test_fields_of_a_later_release_are_left_out() -> None:
    assert isinstance(read_message(b"north:L-1", value(compression="zstd")), Reference)


def test_only_logs_are_announced_and_their_names_stay_short() -> None:
    assert reference_of(replace(RECORD, suffix=".exchange")) is None
    assert reference_of(replace(RECORD, file_name=None)) == replace(reference(), file_name=f"{DIGEST}.blf")
    long = reference_of(replace(RECORD, file_name="x" * 300 + ".blf"))
    assert long is not None
    assert (len(long.file_name), long.file_name[-5:]) == (255, "x.blf")
    assert len(message_of(replace(long, vehicle="v" * 64), "f" * 64)[1]) < MOST_BYTES


@pytest.mark.parametrize(
    ("sent", "outcome", "text"),
    [
        (None, Outcome.MALFORMED, "no value"),
        (b"", Outcome.MALFORMED, "no JSON"),
        (b"\xff\xfe", Outcome.MALFORMED, "no JSON"),
        (b"[" * 4000, Outcome.MALFORMED, "no JSON"),
        (b"[1]", Outcome.MALFORMED, "no object with a version"),
        (b'{"sha256": "' + b"ab" * 32 + b'"}', Outcome.MALFORMED, "no object with a version"),
        (value(version=True), Outcome.MALFORMED, "no object with a version"),
        (value(version=2), Outcome.OTHER_VERSION, "version 2, this release reads version 1"),
        (value(padding="x" * MOST_BYTES), Outcome.MALFORMED, "a reference has at most 4,096"),
        (value(sha256="AB" * 32), Outcome.MALFORMED, "sha256"),
        (value(sha256="ab" * 31), Outcome.MALFORMED, "sha256"),
        (value(sha256="../" * 21 + "x"), Outcome.MALFORMED, "sha256"),
        (value(sha256=None), Outcome.MALFORMED, "sha256"),
        (value(format="pdf"), Outcome.MALFORMED, "none of .blf"),
        (value(format="../x"), Outcome.MALFORMED, "format"),
        (value(vehicle=""), Outcome.MALFORMED, "vehicle"),
        (value(vehicle="L\n1"), Outcome.MALFORMED, "vehicle"),
        (value(vehicle="v" * 65), Outcome.MALFORMED, "vehicle"),
        (value(size_bytes=0), Outcome.MALFORMED, "size_bytes"),
        (value(size_bytes=1 << 63), Outcome.MALFORMED, "size_bytes"),
        (value(size_bytes="1234"), Outcome.MALFORMED, "size_bytes"),
        (value(file_name="a\x00b"), Outcome.MALFORMED, "file_name"),
        (value(received_at="2026-09-21T14:13:20"), Outcome.MALFORMED, "received_at"),
        (value(received_at=7), Outcome.MALFORMED, "received_at"),
        (value(vehicle="L-2"), Outcome.CONTRADICTORY, "'north:L-1' and names vehicle 'L-2'"),
    ],
)
def test_what_is_no_reference_is_refused_with_its_reason(sent: bytes | None, outcome: Outcome, text: str) -> None:
    found = read_message(b"north:L-1", sent)
    assert isinstance(found, Refused)
    assert found.outcome is outcome
    assert text in found.text
    assert len(found.text) < 600


@pytest.mark.parametrize("key", [b"north:L-2", b"L-1", b"north:XL-1", b"\xff\xff", b""])
def test_a_key_of_another_vehicle_contradicts_its_body(key: bytes) -> None:
    found = read_message(key, value())
    assert isinstance(found, Refused)
    assert found.outcome is Outcome.CONTRADICTORY


def test_a_value_of_just_the_size_is_read() -> None:
    room = MOST_BYTES - len(value(padding=""))
    assert isinstance(read_message(b"north:L-1", value(padding="x" * room)), Reference)
    assert isinstance(read_message(b"north:L-1", value(padding="x" * (room + 1))), Refused)
