"""The codec against cantools, byte for byte and frame by frame, and against its own inverse."""

from __future__ import annotations

from importlib.resources import files

import cantools
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from estimation.errors import ParameterError
from estimation.values.windows import ACCELERATIONS
from ingest.catalogue import MessagePlan, default_catalogue
from ingest.codec import decode, encode
from ingest.frames import ERROR_FLAG, EXTENDED_FLAG, REMOTE_FLAG, FrameBatch, batch_of, concatenate, take

CATALOGUE = default_catalogue()
DATABASE = cantools.database.load_file(str(files("ingest") / "dbc" / "treadwatch.dbc"))
PLANS = sorted(CATALOGUE.messages.values(), key=lambda plan: plan.arbitration_id)


def frames_of(arbitration_id: int, payloads: list[bytes], length: int) -> FrameBatch:
    data = np.array([list(payload[:length].ljust(8, b"\0")) for payload in payloads], dtype=np.uint8).reshape(-1, 8)
    return batch_of(arbitration_id, np.arange(len(payloads)), data, length)


def test_catalogue_and_cantools_hold_the_same_messages() -> None:
    assert {m.frame_id: m.length for m in DATABASE.messages} == {p.arbitration_id: p.length for p in PLANS}


@pytest.mark.parametrize("plan", PLANS, ids=lambda plan: plan.name)
@settings(max_examples=25)
@given(payloads=st.lists(st.binary(min_size=8, max_size=8), min_size=1, max_size=20))
def test_cantools_reads_the_same_bytes_to_the_same_values(plan: MessagePlan, payloads: list[bytes]) -> None:
    batch = frames_of(plan.arbitration_id, payloads, plan.length)
    decoded = decode(CATALOGUE, batch)
    ours = decoded.messages[plan.arbitration_id]
    invalid, clipped, values = ours.invalid(), ours.clipped(), ours.values()
    for row, data in enumerate(batch.data):
        frame = bytes(data[: plan.length])
        scaled = DATABASE.decode_message(plan.arbitration_id, frame, decode_choices=False)
        raw = DATABASE.decode_message(plan.arbitration_id, frame, decode_choices=False, scaling=False)
        for column, signal in enumerate(plan.signals):
            theirs = DATABASE.get_message_by_frame_id(plan.arbitration_id).get_signal_by_name(signal.name)
            assert ours.raw[row, column] == raw[signal.name]
            outside = not theirs.minimum - 1e-9 <= scaled[signal.name] <= theirs.maximum + 1e-9
            assert invalid[row, column] == outside
            if not (outside or clipped[row, column]):
                assert values[row, column] == scaled[signal.name]
            else:
                assert np.isnan(values[row, column])
    assert decoded.counts.invalid_values == invalid.sum()
    assert decoded.counts.clipped_values == clipped.sum()


@pytest.mark.parametrize("plan", PLANS, ids=lambda plan: plan.name)
@settings(max_examples=25)
@given(data=st.data())
def test_encode_is_what_cantools_encodes(plan: MessagePlan, data: st.DataObject) -> None:
    raws = {s.name: data.draw(st.integers(s.raw_minimum, s.raw_maximum), label=s.name) for s in plan.signals}
    values = {s.name: raws[s.name] * s.scale + s.offset for s in plan.signals}
    batch = encode(plan, np.array([7]), values)
    theirs = DATABASE.encode_message(plan.arbitration_id, raws, scaling=False)
    assert bytes(batch.data[0, : plan.length]) == theirs
    assert batch.dlc[0] == plan.length


def test_encode_rounds_clips_and_says_not_available() -> None:
    plan = CATALOGUE.find("ACCELERATION", 3)
    scale = plan.signal("lateral_acceleration").scale
    wanted = np.array([0.4 * scale, 0.6 * scale, 1e9, -1e9, np.nan])
    batch = encode(plan, np.arange(5), {"lateral_acceleration": wanted})
    values = decode(CATALOGUE, batch).messages[plan.arbitration_id]
    assert values.raw[:, 0].tolist() == [0, 1, 32767, -32767, -32768]
    assert values.clipped()[:, 0].tolist() == [False, False, True, True, False]
    assert values.invalid()[:, 0].tolist() == [False, False, False, False, True]
    assert values.valid()[:, 1].tolist() == [False] * 5, "signals that are not given are not available"


def test_encode_refuses_what_it_cannot_say() -> None:
    with pytest.raises(ParameterError, match="no signal vertical"):
        encode(CATALOGUE.find("ACCELERATION", 1), np.arange(2), {"vertical": 0.0})
    with pytest.raises(ParameterError, match="NaN"):
        encode(CATALOGUE.find("SYNC"), np.arange(2), {"counter": np.array([1.0, np.nan])})


@settings(max_examples=25)
@given(order=st.permutations(range(8)), repeats=st.integers(1, 3))
def test_every_frame_is_counted_once(order: list[int], repeats: int) -> None:
    payload = np.zeros((1, 8), np.uint8)
    one = np.arange(1)
    kinds = [
        batch_of(0x181, one, payload, 8),
        batch_of(0x181, one, payload, 7),  # wrong length
        batch_of(0x055, one, payload, 8),  # unknown
        batch_of(0x181 | EXTENDED_FLAG, one, payload, 8),
        batch_of(0x181 | REMOTE_FLAG, one, payload, 8),
        batch_of(0x181 | ERROR_FLAG, one, payload, 8),
        batch_of(0x7FFF, one, payload, 8),  # too large for 11 bits
        batch_of(0x081, one, payload, 8),
    ]
    batch = concatenate([take(kinds[i], np.zeros(repeats, np.int64)) for i in order])
    decoded = decode(CATALOGUE, batch)
    counts = decoded.counts
    assert (counts.decoded, counts.wrong_lengths, counts.unknown_identifiers) == (2 * repeats, repeats, repeats)
    assert (counts.extended_frames, counts.remote_frames, counts.error_frames) == (2 * repeats, repeats, repeats)
    assert counts.frames == len(batch) == 8 * repeats
    for values in decoded.messages.values():
        assert np.all(batch.arbitration_id[values.index] == values.plan.arbitration_id)
        assert np.all(np.diff(values.index) > 0)


def test_no_frames_decode_to_nothing() -> None:
    decoded = decode(CATALOGUE, concatenate([]))
    assert decoded.counts.frames == 0
    assert not decoded.messages


def test_one_count_is_small_against_the_sensor() -> None:
    """Quantisation noise of every acceleration stays below a tenth of a 100 ug/rtHz sensor's, at 250 Hz."""
    plan = CATALOGUE.find("ACCELERATION", 1)
    assert plan.names == ACCELERATIONS
    for name in ("lateral_acceleration", "mass_lateral_acceleration"):
        density = plan.signal(name).scale / np.sqrt(12.0) / np.sqrt(125.0)
        assert density < 0.1 * 100e-6 * 9.81
