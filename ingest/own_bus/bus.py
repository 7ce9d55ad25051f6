"""A bus of one's own, as values: its messages, where each signal is in them, and what the signals are."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from ingest.catalogue import Catalogue, MessagePlan, SignalPlan


@dataclass(frozen=True, slots=True)
class SignalBits:
    """Where a signal is in the payload, seen as one 64-bit number: of the first byte lowest, or highest."""

    big_endian: bool
    shift: int
    is_float: bool


@dataclass(frozen=True, slots=True)
class OwnMessage:
    """A message, or the part of one that a value of its multiplexer brings."""

    plan: MessagePlan
    bits: tuple[SignalBits, ...]  # of the signals of the plan
    identifier: int  # with the flag of extended ones
    multiplexer: tuple[SignalPlan, SignalBits] | None = None
    multiplexer_value: int = 0


@dataclass(frozen=True, slots=True)
class SignalReference:
    """A signal by the key of its message and its column, and its value in SI: ``raw * scale + offset``."""

    message: int
    column: int
    plan: SignalPlan
    is_float: bool
    scale: float
    offset: float
    derivatives: int = 0
    limit: float = float("inf")  # SI


@dataclass(frozen=True, slots=True)
class StateReference:
    """A signal that says how good samples are, and the raw value that says they are."""

    signal: SignalReference
    good: int


@dataclass(frozen=True, slots=True)
class OwnNode:
    """The sensors of one axle, in the order of the accelerations of a window."""

    axle: int
    sensors: tuple[SignalReference, SignalReference, SignalReference, SignalReference]
    sequence: SignalReference | None
    valid: StateReference | None
    clipped: StateReference | None
    fault: StateReference | None


@dataclass(frozen=True, slots=True)
class OwnVehicle:
    """The signals of the vehicle; where the section is a number it is that one always."""

    speed: SignalReference
    odometer: SignalReference
    distance: SignalReference
    track_section: SignalReference | int
    position_quality: SignalReference | None


@dataclass(frozen=True, slots=True)
class CanopenClock:
    """SYNC with its counter, and TIME_OF_DAY."""

    counter: SignalReference
    milliseconds: SignalReference
    days: SignalReference


@dataclass(frozen=True, slots=True)
class StampClock:
    """The stamps of the log; the messages (one of each multiplexer value) that mark a sampling instant."""

    reference: int  # identifier of the message, with the flag of extended ones


@dataclass(frozen=True, slots=True)
class OwnBus(Catalogue):
    """A DBC file with its mapping; ``messages`` are those of the mapping, by keys that are no identifiers."""

    own: Mapping[int, OwnMessage]
    lengths: Mapping[int, int]  # of all messages of the DBC file by identifier, bytes
    multiplexers: Mapping[int, tuple[int, ...]]  # values that the DBC file knows, by identifier
    clock: CanopenClock | StampClock
    vehicle: OwnVehicle
    nodes: tuple[OwnNode, ...]
    vehicle_classes: tuple[str, ...] = ()
