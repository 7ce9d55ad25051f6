"""Frames <-> SI signals, vectorised over all frames of a message.

The two loops that touch every frame are compiled: frames by identifier, and raw counts to SI values.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Annotated, Any, Self

import numpy as np
import numpy.typing as npt

from estimation.compiled import compiled
from estimation.errors import ParameterError
from estimation.values.arrays import BoolArray, FloatArray, IntArray, freeze, frozen_array
from ingest.catalogue import Catalogue, MessagePlan, SignalPlan
from ingest.frames import DATA_BYTES, ERROR_FLAG, REMOTE_FLAG, FrameBatch, batch_of

STANDARD_IDENTIFIERS = 0x800


@compiled(nogil=True)
def count_by_identifier(
    arbitration_id: npt.NDArray[np.uint32], dlc: npt.NDArray[np.uint8], lengths: npt.NDArray[np.int16]
) -> tuple[IntArray, int, int]:
    """Count the frames that have an 11-bit identifier by identifier.

    Args:
        lengths: (2048,) bytes that a frame must have, -1 for unknown identifiers.

    Returns:
        counts: (2049,) good frames by identifier, shifted by one: their cumulative sum is where each identifier starts.
        wrong: Frames with a known identifier and another length.
        unknown: Frames with an unknown identifier.
    """
    counts = np.zeros(STANDARD_IDENTIFIERS + 1, np.int64)
    wrong = 0
    unknown = 0
    for i in range(arbitration_id.shape[0]):
        identifier = arbitration_id[i]
        if identifier < STANDARD_IDENTIFIERS:
            length = lengths[identifier]
            if length == dlc[i]:
                counts[identifier + 1] += 1
            elif length < 0:
                unknown += 1
            else:
                wrong += 1
    return counts, wrong, unknown


@compiled(nogil=True)
def gather_by_identifier(
    arbitration_id: npt.NDArray[np.uint32],
    dlc: npt.NDArray[np.uint8],
    lengths: npt.NDArray[np.int16],
    words: npt.NDArray[np.uint64],
    starts: IntArray,
) -> tuple[IntArray, npt.NDArray[np.uint64]]:
    """Return positions and payload words of the good frames, by identifier, each in the order of the batch.

    ``starts`` is the cumulative sum of what :func:`count_by_identifier` returns.
    """
    place = starts.copy()
    index = np.empty(starts[-1], np.int64)
    gathered = np.empty(starts[-1], np.uint64)
    for i in range(arbitration_id.shape[0]):
        identifier = arbitration_id[i]
        if identifier < STANDARD_IDENTIFIERS and lengths[identifier] == dlc[i]:
            at = place[identifier]
            place[identifier] = at + 1
            index[at] = i
            gathered[at] = words[i]
    return index, gathered


@compiled(nogil=True)
def scaled(
    raw: npt.NDArray[np.signedinteger[Any]], low: IntArray, high: IntArray, scale: FloatArray, offset: FloatArray
) -> FloatArray:
    """Return ``raw * scale + offset`` (n, m), NaN where ``raw`` is outside ``low..high`` (each (m,))."""
    n, m = raw.shape
    values = np.empty((n, m))
    for i in range(n):
        for j in range(m):
            value = np.int64(raw[i, j])
            values[i, j] = value * scale[j] + offset[j] if low[j] <= value <= high[j] else np.nan
    return values


@compiled(nogil=True)
def count_within(raw: npt.NDArray[np.signedinteger[Any]], low: IntArray, high: IntArray) -> int:
    """Count the raw values (n, m) inside ``low..high`` (each (m,))."""
    n, m = raw.shape
    count = 0
    for i in range(n):
        for j in range(m):
            value = np.int64(raw[i, j])
            count += low[j] <= value <= high[j]
    return count


RawArray = npt.NDArray[np.signedinteger[Any]]


class Counts:
    """Counts that can be added, field by field."""

    __slots__: tuple[str, ...] = ()

    def __add__(self, other: Self) -> Self:
        return type(self)(*(getattr(self, name) + getattr(other, name) for name in self.__slots__))


@dataclass(frozen=True, slots=True)
class FrameCounts(Counts):
    """What became of the frames of a batch; every frame is in exactly one of the first seven after ``frames``.

    ``invalid_values`` and ``clipped_values`` count signal values, not frames.
    """

    frames: int = 0
    decoded: int = 0
    unknown_identifiers: int = 0
    wrong_lengths: int = 0
    extended_frames: int = 0
    remote_frames: int = 0
    error_frames: int = 0
    invalid_values: int = 0
    clipped_values: int = 0


@dataclass(frozen=True, slots=True)
class RawValues:
    """The raw values of frames of one message, one column a signal."""

    plan: MessagePlan
    raw: RawArray  # (n, m)

    def __post_init__(self) -> None:
        freeze(self)
        shape = (None, len(self.plan.signals))
        object.__setattr__(self, "raw", frozen_array(self.raw, shape, self.raw.dtype, name="raw"))

    def column(self, name: str) -> IntArray:
        """Return the raw values of one signal, (n,) int64."""
        return self.raw[:, self.plan.names.index(name)].astype(np.int64)

    def values(self, *, with_clipped: bool = False) -> FloatArray:
        """Return (n, m) values in the units of the catalogue; NaN where not valid.

        Values that stand for clipping are not valid, or given as they are, at the end of the range.
        """
        scale = np.array([signal.scale for signal in self.plan.signals])
        offset = np.array([signal.offset for signal in self.plan.signals])
        return scaled(self.raw, *raw_limits(self.plan, with_clipped=with_clipped), scale, offset)

    def valid(self) -> BoolArray:
        """Return (n, m): inside the limits, and neither "not available" nor clipped."""
        low, high = raw_limits(self.plan, with_clipped=False)
        return (self.raw >= low) & (self.raw <= high)

    def invalid(self) -> BoolArray:
        """Return (n, m): the raw value says "not available" or is outside the limits."""
        low, high = raw_limits(self.plan, with_clipped=True)
        return (self.raw < low) | (self.raw > high)

    def clipped(self) -> BoolArray:
        """Return (n, m): the raw value sits on a limit that is an end of the raw range."""
        return ~(self.valid() | self.invalid())


@dataclass(frozen=True, slots=True)
class MessageValues(RawValues):
    """All frames of one message in a batch."""

    index: Annotated[IntArray, "n"]  # position in the batch, increasing


@dataclass(frozen=True, slots=True)
class Decoded:
    """The frames of a batch by arbitration id, and what became of all of them."""

    messages: Mapping[int, MessageValues]
    counts: FrameCounts


def raw_limits(plan: MessagePlan, *, with_clipped: bool) -> tuple[IntArray, IntArray]:
    """Return the lowest and highest raw values (m,) that are values, with or without those that stand for clipping."""
    low = [s.raw_minimum + (s.clips and s.signed and not with_clipped) for s in plan.signals]
    high = [s.raw_maximum - (s.clips and not with_clipped) for s in plan.signals]
    return np.array(low, dtype=np.int64), np.array(high, dtype=np.int64)


def decode(catalogue: Catalogue, batch: FrameBatch) -> Decoded:
    """Sort the frames of a batch by message and unpack their raw values.

    Frames that are no data frames with an 11-bit identifier of the catalogue and the length it gives are counted by
    reason and left out.
    """
    lengths = np.full(STANDARD_IDENTIFIERS, -1, dtype=np.int16)
    for arbitration_id, plan in catalogue.messages.items():
        lengths[arbitration_id] = plan.length
    by_id, wrong, unknown = count_by_identifier(batch.arbitration_id, batch.dlc, lengths)
    starts = np.cumsum(by_id)
    words = batch.data.view("<u8").ravel()
    index, words = gather_by_identifier(batch.arbitration_id, batch.dlc, lengths, words, starts)
    index.flags.writeable = words.flags.writeable = False  # what is cut from them are views, not copies
    messages = {}
    for arbitration_id, plan in catalogue.messages.items():
        span = slice(int(starts[arbitration_id]), int(starts[arbitration_id + 1]))
        if span.stop > span.start:
            messages[arbitration_id] = MessageValues(plan, unpack(plan, words[span]), index[span])
    invalid, clipped = _count_values(messages)
    strange = len(batch) - wrong - unknown - int(starts[-1])  # without an 11-bit identifier
    error = remote = 0
    if strange:
        is_error = (batch.arbitration_id & ERROR_FLAG) != 0
        error = int(np.count_nonzero(is_error))
        remote = int(np.count_nonzero(~is_error & ((batch.arbitration_id & REMOTE_FLAG) != 0)))
    counts = FrameCounts(
        frames=len(batch),
        decoded=int(starts[-1]),
        unknown_identifiers=unknown,
        wrong_lengths=wrong,
        extended_frames=strange - error - remote,
        remote_frames=remote,
        error_frames=error,
        invalid_values=invalid,
        clipped_values=clipped,
    )
    return Decoded(MappingProxyType(messages), counts)


def _count_values(messages: Mapping[int, MessageValues]) -> tuple[int, int]:
    total = valid = within = 0
    for values in messages.values():
        inside = count_within(values.raw, *raw_limits(values.plan, with_clipped=False))
        total += values.raw.size
        valid += inside
        if inside == values.raw.size:
            within += inside
        else:
            within += count_within(values.raw, *raw_limits(values.plan, with_clipped=True))
    return total - within, within - valid


def unpack(plan: MessagePlan, words: npt.NDArray[np.uint64]) -> RawArray:
    """Return the raw values (n, m) in payloads given as little-endian 64-bit words (n,)."""
    if plan.four_int16:
        return words.view("<i2").reshape(-1, 4)
    raw = np.empty((len(words), len(plan.signals)), dtype=np.int64)
    for column, signal in enumerate(plan.signals):
        raw[:, column] = (words >> np.uint64(signal.start_bit)) & np.uint64((1 << signal.bits) - 1)
        if signal.signed:
            raw[:, column] -= (raw[:, column] >> (signal.bits - 1)) << signal.bits
    return raw


def encode(plan: MessagePlan, t_ns: IntArray, values: Mapping[str, npt.ArrayLike]) -> FrameBatch:
    """Return one frame per time with signals, (n,) or one value each, in the units of the catalogue.

    NaN becomes "not available"; a value beyond a limit is clipped to it; signals that are not given are "not
    available" where the catalogue has a code for that, else 0.
    """
    unknown = set(values) - set(plan.names)
    if unknown:
        raise ParameterError(f"message {plan.name} has no signal {', '.join(sorted(unknown))}", field=plan.name)
    n = len(t_ns)
    words = np.zeros(n, dtype="<u8")
    for signal in plan.signals:
        raw = raw_of(signal, np.broadcast_to(np.asarray(values.get(signal.name, np.nan), np.float64), (n,)))
        if signal.name not in values and signal.raw_invalid is None:
            raw = np.zeros(n, dtype=np.int64)
        words |= (raw.astype(np.uint64) & np.uint64((1 << signal.bits) - 1)) << np.uint64(signal.start_bit)
    data = words.view(np.uint8).reshape(n, DATA_BYTES)
    if any(
        plan.signal(name).raw_invalid is None and np.isnan(np.asarray(given)).any() for name, given in values.items()
    ):
        raise ParameterError("NaN in a signal that cannot say 'not available'", field=plan.name)
    return batch_of(plan.arbitration_id, t_ns, data, plan.length)


def raw_of(signal: SignalPlan, values: FloatArray) -> IntArray:
    """Return the raw values (n,) of a signal: rounded to the nearest count, clipped, NaN as "not available"."""
    counts = np.rint((values - signal.offset) / signal.scale)
    missing = np.isnan(counts)
    raw = np.clip(np.where(missing, 0.0, counts), signal.raw_minimum, signal.raw_maximum).astype(np.int64)
    if signal.raw_invalid is not None:
        raw[missing] = signal.raw_invalid
    return raw
