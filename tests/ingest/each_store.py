"""One run in three recordings, taken in by each way into any store of raw recordings."""

from __future__ import annotations

from pathlib import Path

from test_reassembly import LENGTH_S, pieces_of
from test_receiver import CountingClock, files_of
from vehicle_bus import VEHICLE, Run

from fleet_db.keeping.checks import ScrubPlan, scrub
from fleet_db.raw import RawStore
from fleet_db.records import ChunkState
from fleet_db.storage import SqlStorage
from ingest.catalogue import default_catalogue
from ingest.intake.backlog import DecodedChunks, decode_received
from ingest.receipts import Arrival, Chunk, ChunkStorage, Stored
from ingest.receiver import Receiver

RUN = Run(seconds=24.0)


def quietly(_done: int, _total: int) -> None:
    """Show no progress."""


def receiver_of(storage: SqlStorage, raw: RawStore) -> Receiver:
    return Receiver(storage, raw, default_catalogue(), CountingClock(), window_length_s=LENGTH_S)


def recordings(folder: Path) -> list[Path]:
    return files_of(pieces_of(RUN, 9.0, 16.0), folder)


def digests(storage: SqlStorage) -> dict[str, ChunkState]:
    with storage.read() as unit:
        return {one.digest: one.state for state in ChunkState for one in unit.chunks.with_state(state)}


def hand_in(storage: SqlStorage, raw: RawStore, paths: list[Path]) -> list[Stored]:
    arrivals = []
    for path in paths:
        incoming = raw.incoming(path.suffix)
        incoming.write(path.read_bytes())
        incoming.finish()
        arrivals.append(Arrival(incoming, Chunk(VEHICLE, path.suffix, path.name, None)))
    answers = ChunkStorage(storage, raw, CountingClock()).store(arrivals)
    assert all(isinstance(answer, Stored) for answer in answers)
    return [answer for answer in answers if isinstance(answer, Stored)]


def decode(storage: SqlStorage, raw: RawStore) -> DecodedChunks:
    return decode_received(storage, receiver_of(storage, raw), "the test", quietly)


def scrubbed(storage: SqlStorage, raw: RawStore) -> set[str]:
    """Return the digests that a scrub finds damaged or missing."""
    found: list[str] = []
    scrub(storage, raw, ScrubPlan(), lambda: 1, lambda fault: found.append(fault.file.digest), quietly)
    return set(found)
