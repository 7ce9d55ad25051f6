"""The signal catalogue: a DBC file, read once, as a plan for the vectorised codec.

cantools reads the file; it is not used after that. The conventions on top of DBC are few: the name of a message
ends with its node (``ACCELERATION_3``), ``GenMsgCycleTime`` of SYNC is the sampling interval, and ``InvalidRawValue``
is the raw value that says "not available".
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import as_file, files
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import numpy.typing as npt

from estimation.errors import CatalogueError
from estimation.values.arrays import IntArray
from ingest.input_file import SETTINGS_BYTES, read_text_within

NO_SCALE = "a scale of 0: every value would be the offset"
VEHICLE_NODE = 16

ACCELERATION = "ACCELERATION"
STATUS = "STATUS"
EMERGENCY = "EMERGENCY"
MOTION = "MOTION"
PLACE = "PLACE"
POSITION = "POSITION"
HEARTBEAT = "HEARTBEAT"
SYNC = "SYNC"
TIME = "TIME"

NEEDED = {
    SYNC: ("counter",),
    TIME: ("milliseconds", "days"),
    ACCELERATION: ("lateral_acceleration", "yaw_acceleration", "roll_acceleration", "mass_lateral_acceleration"),
    STATUS: ("sample_counter", "self_test_failed"),
    MOTION: ("speed", "odometer"),
    POSITION: ("track_section", "distance", "position_quality"),
}
"""Signals that the receiver cannot do without, by kind of message."""

_NAME = re.compile(r"(?P<kind>[A-Z]+)(?:_(?P<node>\d+))?")


@dataclass(frozen=True, slots=True)
class SignalPlan:
    """The bits of a signal in the payload and the meaning of its raw value: ``value = raw * scale + offset``."""

    name: str
    start_bit: int
    bits: int
    signed: bool
    scale: float
    offset: float
    unit: str
    raw_minimum: int
    raw_maximum: int
    raw_invalid: int | None  # the raw value that says "not available"
    clips: bool  # the limits are the ends of the raw range: a value on a limit was clipped


@dataclass(frozen=True, slots=True)
class MessagePlan:
    """One message: its kind and node, its length, its signals and how to view its payload."""

    name: str
    kind: str
    node: int | None
    arbitration_id: int
    length: int  # bytes
    cycle_ns: int  # 0 when sent on events
    signals: tuple[SignalPlan, ...]

    def signal(self, name: str) -> SignalPlan:
        """Return the plan of one signal."""
        for plan in self.signals:
            if plan.name == name:
                return plan
        raise CatalogueError(f"message {self.name} has no signal {name}", field=name)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the signals, in the order of their bits."""
        return tuple(plan.name for plan in self.signals)

    @property
    def four_int16(self) -> bool:
        """Whether the payload is just four signed 16-bit numbers, so that a view of it is the raw values."""
        return [(p.start_bit, p.bits, p.signed) for p in self.signals] == [(16 * i, 16, True) for i in range(4)]


@dataclass(frozen=True, slots=True)
class Catalogue:
    """All messages of a vehicle bus by arbitration id."""

    messages: Mapping[int, MessagePlan]
    sample_interval_ns: int

    @property
    def wheelset_nodes(self) -> tuple[int, ...]:
        """Nodes that have an acceleration message: the wheelsets that the bus has room for."""
        return tuple(sorted(p.node for p in self.messages.values() if p.kind == ACCELERATION and p.node is not None))

    def find(self, kind: str, node: int | None = None) -> MessagePlan:
        """Return the message of a kind and node."""
        for plan in self.messages.values():
            if plan.kind == kind and plan.node == node:
                return plan
        raise CatalogueError(f"no message {kind}{'' if node is None else f' of node {node}'}")


def load_catalogue(path: Path) -> Catalogue:
    """Read a DBC file: 11-bit identifiers, little endian, integers, no multiplexing."""
    database = parse_dbc(path)
    messages = {message.frame_id: _message_plan(message, path) for message in database.messages}
    interval = next((plan.cycle_ns for plan in messages.values() if plan.kind == SYNC), 0)
    if interval == 0:
        raise CatalogueError("SYNC needs a GenMsgCycleTime: it is the sampling interval", file=path, field=SYNC)
    catalogue = Catalogue(MappingProxyType(messages), interval)
    _check_needed(catalogue, path)
    return catalogue


@cache
def default_catalogue() -> Catalogue:
    """Return the catalogue that comes with the package."""
    with as_file(files("ingest") / "dbc" / "treadwatch.dbc") as path:
        return load_catalogue(path)


def parse_dbc(path: Path) -> Any:  # noqa: ANN401 - cantools is untyped
    """Return a DBC file as cantools reads it."""
    import cantools  # noqa: PLC0415 - a slow import, needed only to read a catalogue

    try:
        text = read_text_within(path, SETTINGS_BYTES, CatalogueError, encoding="cp1252", errors="replace")
        return cantools.database.load_string(text, database_format="dbc", strict=True)
    except (cantools.database.errors.Error, ValueError, KeyError) as error:
        raise CatalogueError(f"is no DBC file: {error}", file=path) from error


def _message_plan(message: Any, path: Path) -> MessagePlan:  # noqa: ANN401 - cantools is untyped
    match = _NAME.fullmatch(message.name)
    if match is None:
        raise CatalogueError("a message is named KIND or KIND_node", file=path, field=message.name)
    if message.is_extended_frame or message.is_fd or message.length > 8:  # noqa: PLR2004 - classic CAN
        raise CatalogueError("a message has an 11-bit identifier and at most 8 bytes", file=path, field=message.name)
    signals = sorted(message.signals, key=lambda signal: int(signal.start))
    node = match["node"]
    return MessagePlan(
        name=message.name,
        kind=match["kind"],
        node=int(node) if node is not None else None,
        arbitration_id=message.frame_id,
        length=message.length,
        cycle_ns=int(message.cycle_time or 0) * 1_000_000,
        signals=tuple(_signal_plan(signal, f"{message.name}.{signal.name}", path) for signal in signals),
    )


def _signal_plan(signal: Any, name: str, path: Path) -> SignalPlan:  # noqa: ANN401 - cantools is untyped
    if signal.byte_order != "little_endian" or signal.is_float or signal.is_multiplexer or signal.multiplexer_ids:
        raise CatalogueError("a signal is a little-endian integer, not multiplexed", file=path, field=name)
    if signal.length > 32:  # noqa: PLR2004 - raw values stay exact in float64 and int64
        raise CatalogueError("a signal has at most 32 bits", file=path, field=name)
    scale, offset = float(signal.scale), float(signal.offset)
    if not scale:
        raise CatalogueError(NO_SCALE, file=path, field=name)
    lowest, highest = raw_range(signal)
    invalid = _invalid(signal)
    limits = [
        end if limit is None else round((float(limit) - offset) / scale)
        for limit, end in ((signal.minimum, lowest), (signal.maximum, highest))
    ]
    minimum, maximum = min(limits), max(limits)
    if not lowest <= minimum < maximum <= highest:
        raise CatalogueError("the limits do not fit the number of bits", file=path, field=name)
    if invalid is not None and (minimum <= invalid <= maximum or not lowest <= invalid <= highest):
        raise CatalogueError("InvalidRawValue is inside the limits or outside the raw range", file=path, field=name)
    clips = invalid is not None and maximum - minimum == highest - lowest - 1
    return plan_of(signal, minimum, maximum, clips=clips)


def raw_range(signal: Any) -> tuple[int, int]:  # noqa: ANN401 - cantools is untyped
    """Return the lowest and the highest raw value that the bits of a signal hold."""
    lowest = -(1 << (signal.length - 1)) if signal.is_signed or signal.is_float else 0
    return lowest, lowest + (1 << signal.length) - 1


def _invalid(signal: Any) -> int | None:  # noqa: ANN401 - cantools is untyped
    attribute = signal.dbc.attributes.get("InvalidRawValue") if signal.dbc else None
    return int(attribute.value) if attribute is not None else None


def plan_of(signal: Any, minimum: int, maximum: int, *, clips: bool) -> SignalPlan:  # noqa: ANN401 - cantools is untyped
    """Return a signal of a DBC file with its raw limits."""
    return SignalPlan(
        name=signal.name,
        start_bit=signal.start,
        bits=signal.length,
        signed=signal.is_signed,
        scale=float(signal.scale),
        offset=float(signal.offset),
        unit=signal.unit or "",
        raw_minimum=minimum,
        raw_maximum=maximum,
        raw_invalid=_invalid(signal),
        clips=clips,
    )


def _check_needed(catalogue: Catalogue, path: Path) -> None:
    kinds = {plan.kind for plan in catalogue.messages.values()}
    for kind, names in NEEDED.items():
        if kind not in kinds:
            raise CatalogueError("the message is missing", file=path, field=kind)
        for plan in catalogue.messages.values():
            missing = set(names) - set(plan.names) if plan.kind == kind else set()
            if missing:
                raise CatalogueError(f"lacks {', '.join(sorted(missing))}", file=path, field=plan.name)
    for plan in catalogue.messages.values():
        if plan.kind == ACCELERATION and not plan.four_int16:
            raise CatalogueError("an acceleration message is four int16", file=path, field=plan.name)


SYNC_ID = 0x080
TIME_ID = 0x100

SYNC_PERIOD = 240  # the counter runs 1..240 (CiA 301, object 1019h)
DAY_MS = 86_400_000
EPOCH_DAYS = 5113  # days from 1970-01-01 to 1984-01-01, where CANopen's TIME_OF_DAY begins


def sync_counter(tick: npt.ArrayLike) -> IntArray:
    """Return the counter that the SYNC number ``tick`` (sampling intervals since 1970-01-01) carries: 1..240."""
    return np.asarray(tick, dtype=np.int64) % SYNC_PERIOD + 1


def time_of_day(t_ns: npt.ArrayLike) -> tuple[IntArray, IntArray]:
    """Return ``(milliseconds after midnight, days since 1984-01-01)`` of vehicle times in ns UTC, truncated."""
    milliseconds = np.asarray(t_ns, dtype=np.int64) // 1_000_000
    return milliseconds % DAY_MS, milliseconds // DAY_MS - EPOCH_DAYS


def vehicle_time_ns(milliseconds: npt.ArrayLike, days: npt.ArrayLike) -> IntArray:
    """Return the vehicle time (n,) in ns UTC of TIME frames: ms after midnight, days since 1984-01-01."""
    whole_days = np.asarray(days, dtype=np.int64) + EPOCH_DAYS
    return (whole_days * DAY_MS + np.asarray(milliseconds, dtype=np.int64)) * 1_000_000
