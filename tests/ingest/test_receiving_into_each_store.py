"""Every way in gives the same windows with raw recordings in files and in a bucket; what is lost there is healed."""

from __future__ import annotations

from pathlib import Path

import pytest
from each_store import decode, digests, hand_in, quietly, receiver_of, recordings, scrubbed
from raw_stores import Behind, in_bucket
from s3_server import running_s3_server
from test_reassembly import Windows, made_of, mounting
from vehicle_bus import VEHICLE, register

from estimation.errors import PassingFaultError
from estimation.values.runs import SubjectKind
from fleet_db.keeping.checks import check_deep
from fleet_db.records import ChunkState
from fleet_db.storage import SqlStorage
from ingest.reassembly import ASSEMBLY


@pytest.fixture
def registered(sqlite_storage: SqlStorage) -> SqlStorage:
    with sqlite_storage.write() as unit:
        register(unit)
    return sqlite_storage


@pytest.fixture(scope="module")
def windows() -> dict[str, Windows]:
    """Return where each way into each store leaves the windows that it makes: they are all the same."""
    return {}


def same(windows: dict[str, Windows], storage: SqlStorage) -> None:
    found = made_of(storage)
    assert len(found) == 6
    assert windows.setdefault("first", found) == found


def test_files_that_are_ingested(
    registered: SqlStorage, raw_behind: Behind, windows: dict[str, Windows], tmp_path: Path
) -> None:
    receiver = receiver_of(registered, raw_behind.store)
    receiver.reassembler.work_off()
    for path in recordings(tmp_path):
        assert receiver.receive_file(path, VEHICLE).record.state is ChunkState.DECODED
        assert not receiver_of(registered, raw_behind.store).receive_file(path, VEHICLE).windows_changed
    same(windows, registered)
    assert raw_behind.left() == []


def test_chunks_that_are_handed_in(
    registered: SqlStorage, raw_behind: Behind, windows: dict[str, Windows], tmp_path: Path
) -> None:
    stored = hand_in(registered, raw_behind.store, recordings(tmp_path))
    assert raw_behind.left() == []
    done = decode(registered, raw_behind.store)
    assert (len(stored), done.decoded, done.others) == (3, 3, 0)
    same(windows, registered)
    assert raw_behind.left() == [], "copies that were read are gone"


def test_pieces_of_a_live_bus(
    registered: SqlStorage, raw_behind: Behind, windows: dict[str, Windows], tmp_path: Path
) -> None:
    receiver = receiver_of(registered, raw_behind.store)
    for path in recordings(tmp_path):
        record, known = receiver.keep(path.read_bytes(), ".blf", VEHICLE, path.name)
        assert not known
        receiver.decode_one(record)
    same(windows, registered)
    assert raw_behind.left() == []


def test_what_is_lost_is_found_by_a_scrub_and_healed_by_sending_it_again(
    registered: SqlStorage, raw_behind: Behind, tmp_path: Path
) -> None:
    raw = raw_behind.store
    paths = recordings(tmp_path)
    damaged, gone, whole = (one.record.digest for one in hand_in(registered, raw, paths))
    decode(registered, raw)
    content = raw_behind.content(damaged, ".blf")
    assert content is not None
    raw_behind.write(damaged, ".blf", content[:-1] + bytes([content[-1] ^ 1]))
    raw.remove(gone, ".blf")
    assert scrubbed(registered, raw) == {damaged, gone}
    checked = check_deep(registered, raw, quietly).findings
    assert {(one.kind, one.detail) for one in checked} == {
        ("recording", f"{raw.place(damaged, '.blf')} is damaged: its content has another digest"),
        ("recording", f"{raw.place(gone, '.blf')} is missing"),
    }
    with registered.write() as unit:
        unit.registry.add_mounting(mounting(1, to_ns=1))
    receiver_of(registered, raw).reassembler.work_off()
    with registered.read() as unit:
        held = {item.key for item in unit.quarantine.held(ASSEMBLY) if item.kind is SubjectKind.RECORDING}
    assert held == {damaged, gone}
    again = hand_in(registered, raw, paths)
    assert all(one.known for one in again)
    assert scrubbed(registered, raw) == set()
    assert raw_behind.content(damaged, ".blf") == content
    assert check_deep(registered, raw, quietly).findings == ()
    with registered.write() as unit:
        unit.quarantine.retry()
    receiver_of(registered, raw).reassembler.work_off()
    assert {serial for serial, _ in made_of(registered)} == {"WS-2"}
    assert whole in digests(registered)


@pytest.mark.slow
def test_while_a_bucket_is_away_nothing_counts_as_lost(registered: SqlStorage, tmp_path: Path) -> None:
    with running_s3_server() as server:
        behind = in_bucket(server, "raw", tmp_path, timeout_s=1.0)
        raw = behind.store
        paths = recordings(tmp_path)
        hand_in(registered, raw, paths[:2])
        server.stop()
        with pytest.raises(PassingFaultError, match="cannot be reached"):
            hand_in(registered, raw, paths[2:])
        assert len(digests(registered)) == 2, "what has no bytes has no receipt"
        outcomes = list(receiver_of(registered, raw).decode_stored())
        assert [type(one) for one in outcomes] == [PassingFaultError]
        with pytest.raises(PassingFaultError):
            scrubbed(registered, raw)
        assert set(digests(registered).values()) == {ChunkState.STORED}
        server.start()
        decode(registered, raw)
        made = made_of(registered)
        with registered.write() as unit:
            unit.registry.add_mounting(mounting(1, to_ns=1))
        server.stop()
        with pytest.raises(Exception, match="cannot be reached"):
            receiver_of(registered, raw).reassembler.work_off()
        assert made_of(registered) == made, "windows are not made again without their recordings"
        server.start()
        receiver_of(registered, raw).reassembler.work_off()
        assert {serial for serial, _ in made_of(registered)} == {"WS-2"}
