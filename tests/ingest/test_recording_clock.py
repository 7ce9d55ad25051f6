"""A recording whose clock contradicts its receipt, or itself: rejected with its code; the others go on."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import pytest
from vehicle_bus import VEHICLE, Run, register

from estimation.errors import LogFileError
from estimation.values.reasons import ReasonCode
from estimation.values.units import DAY_NS, SECOND_NS
from fleet_db.raw import FileRawStore
from fleet_db.records import ChunkState, RecordingAction
from fleet_db.storage import SqlStorage
from ingest.catalogue import default_catalogue
from ingest.corrections import Author, RecordingCorrections
from ingest.frames import FrameBatch, concatenate
from ingest.logs import write_blf
from ingest.plausibility import LONGEST_SPAN_NS, MOST_AHEAD_NS, OUR_CLOCK_SET_NS, clock_verdict
from ingest.receiver import Receiver

RECEIVED_NS = 1_760_000_000 * SECOND_NS


class StandingClock:
    def now_ns(self) -> int:
        return RECEIVED_NS


@pytest.mark.parametrize(
    ("first_ns", "last_ns", "received_ns", "refused"),
    [
        (RECEIVED_NS, RECEIVED_NS + MOST_AHEAD_NS, RECEIVED_NS, False),
        (RECEIVED_NS, RECEIVED_NS + MOST_AHEAD_NS + 1, RECEIVED_NS, True),
        (RECEIVED_NS - LONGEST_SPAN_NS, RECEIVED_NS, RECEIVED_NS, False),
        (RECEIVED_NS - LONGEST_SPAN_NS - 1, RECEIVED_NS, RECEIVED_NS, True),
        (RECEIVED_NS, RECEIVED_NS + 9, OUR_CLOCK_SET_NS - 1, False),  # ours was not set: it shows nothing
        (RECEIVED_NS, RECEIVED_NS + 9, OUR_CLOCK_SET_NS, True),
        (RECEIVED_NS - 3650 * DAY_NS, RECEIVED_NS - 3650 * DAY_NS + 9, RECEIVED_NS, False),  # late is late
    ],
)
def test_a_recording_ahead_of_its_receipt_or_too_long_is_refused(
    first_ns: int, last_ns: int, received_ns: int, *, refused: bool
) -> None:
    verdict = clock_verdict(first_ns, last_ns, received_ns)
    assert (None if verdict is None else verdict.code) == (ReasonCode.CLOCK_IMPLAUSIBLE if refused else None)


def test_the_limits_of_a_clock_are_these() -> None:
    assert (MOST_AHEAD_NS / DAY_NS, LONGEST_SPAN_NS / DAY_NS) == (1.0, 31.0)
    assert OUR_CLOCK_SET_NS == 1_577_836_800 * 10**9  # 2020-01-01


def test_a_clock_that_is_ahead_or_spans_decades_costs_its_own_recording_only(
    sqlite_storage: SqlStorage, tmp_path: Path
) -> None:
    with sqlite_storage.write() as unit:
        register(unit)
    receiver = Receiver(
        sqlite_storage, FileRawStore(tmp_path / "raw"), default_catalogue(), StandingClock(), window_length_s=10.0
    )
    good = Run(start_ns=RECEIVED_NS - 3600 * SECOND_NS)
    ahead = Run(start_ns=RECEIVED_NS + 2 * DAY_NS, recorder_offset_ns=good.recorder_offset_ns - 3 * DAY_NS, seed=2)
    decades = concatenate([good_piece(0, 3), good_piece(20 * 365 * DAY_NS, 4)])
    batches = {"a": ahead.frames(), "b": decades, "c": good.frames()}
    paths = [tmp_path / f"{VEHICLE}__{name}.blf" for name in batches]
    for path, batch in zip(paths, batches.values(), strict=True):
        write_blf(path, batch)
    outcomes = [outcome for _, outcome in receiver.receive_files((path, VEHICLE) for path in paths)]
    for outcome in outcomes[:2]:
        assert isinstance(outcome, LogFileError)
    assert "2.0 days ahead" in str(outcomes[0])
    assert "spans 7,300 days" in str(outcomes[1])
    with sqlite_storage.read() as unit:
        rejected = unit.chunks.with_state(ChunkState.REJECTED)
        assert [item.reason.code for item in rejected if item.reason] == [ReasonCode.CLOCK_IMPLAUSIBLE] * 2
        assert len(unit.windows.list("WS-1")) > 0


def good_piece(earlier_ns: int, seed: int) -> FrameBatch:
    """Return ten seconds; the recorder goes on where the vehicle's clock is set."""
    start_ns = RECEIVED_NS - 7200 * SECOND_NS - earlier_ns
    offset = 5 * SECOND_NS + earlier_ns - (20 * SECOND_NS if earlier_ns else 0)
    return Run(seconds=10.0, start_ns=start_ns, recorder_offset_ns=offset, seed=seed).frames()


@dataclass
class SetClock:
    now: int

    def now_ns(self) -> int:
        return self.now


def test_a_recording_that_our_slow_clock_refused_is_decoded_once_it_is_right(
    sqlite_storage: SqlStorage, tmp_path: Path
) -> None:
    with sqlite_storage.write() as unit:
        register(unit)
    clock = SetClock(RECEIVED_NS - 400 * DAY_NS)
    raw = FileRawStore(tmp_path / "raw")
    receiver = Receiver(sqlite_storage, raw, default_catalogue(), clock, window_length_s=10.0)
    path = tmp_path / f"{VEHICLE}__good.blf"
    write_blf(path, Run(start_ns=RECEIVED_NS - 3600 * SECOND_NS).frames())
    with pytest.raises(LogFileError, match="days ahead"):
        receiver.receive_file(path, VEHICLE)
    corrections = RecordingCorrections(sqlite_storage, clock)
    with sqlite_storage.read() as unit:
        digest = unit.chunks.with_state(ChunkState.REJECTED)[0].digest
    received_ns = clock.now
    for now, behind, state in (
        (received_ns, True, ChunkState.REJECTED),  # it still is
        (
            RECEIVED_NS,
            False,
            ChunkState.REJECTED,
        ),  # nobody says that ours was wrong: time alone makes nothing plausible
        (RECEIVED_NS, True, ChunkState.DECODED),
    ):
        clock.now = now
        corrections.correct(
            digest, RecordingAction.RETRY, Author("j.smith", "the clock is right"), our_clock_was_behind=behind
        )
        list(receiver.decode_stored())
        with sqlite_storage.read() as unit:
            found = unit.chunks.get(digest)
            last = unit.recording_changes.list(digest)[-1]
        assert found is not None
        assert found.state is state
        assert found.received_ns == received_ns  # the receipt stays as it was given
        assert last.recorded_ns == now
    assert found.clock_checked_ns == RECEIVED_NS
    corrections.correct(digest, RecordingAction.SET_ASIDE, Author("j.smith", "a test"))
    corrections.correct(digest, RecordingAction.RESTORE, Author("j.smith", "none"))
    list(receiver.decode_stored())
    with sqlite_storage.read() as unit:
        assert [record.digest for record in unit.chunks.with_state(ChunkState.DECODED)] == [digest]
