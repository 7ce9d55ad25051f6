"""A bus of one's own, as values: its messages, where each signal is in them, and what the signals are."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, Self

from pydantic import Field, model_validator

from estimation.values.registry import MAX_AXLES
from ingest.catalogue import Catalogue, MessagePlan, SignalPlan
from ingest.input_file import InputTable, Location, Positive, Text, field_error
from ingest.units import SENSOR_QUANTITIES, Quantity


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


QUANTITIES: Mapping[str, tuple[Quantity, ...]] = {
    **SENSOR_QUANTITIES,
    "odometer": (Quantity.LENGTH,),
    "distance": (Quantity.LENGTH,),
    "track_section": (Quantity.NUMBER,),
    "position_quality": (Quantity.NUMBER,),
    "milliseconds": (Quantity.TIME, Quantity.NUMBER),
    "days": (Quantity.TIME, Quantity.NUMBER),
    "counter": (Quantity.NUMBER,),
}
"""What a signal may measure; those that are not here are bits and counters."""


class SignalTable(InputTable):
    """A signal of a message; ``unit`` where the DBC file has none, or another one."""

    message: Text
    signal: Text
    unit: str | None = None
    multiplexer: int | None = None  # value under which the message carries it


class SensorTable(SignalTable):
    """A signal of a sensor; beyond ``limit``, in its unit, it is clipped."""

    turned: bool = False
    limit: Positive | None = None


class StateTable(SignalTable):
    """A signal that says how good samples are: since the message of it before, up to this one."""

    good: int


class NodeTable(InputTable):
    """The signals of the sensors of one axle."""

    axle: int = Field(ge=1, le=MAX_AXLES)
    lateral: SensorTable
    yaw: SensorTable
    roll: SensorTable
    mass_lateral: SensorTable
    sequence: SignalTable | None = None  # counts the samples, in the message of the lateral acceleration
    valid: StateTable | None = None  # samples are valid where it is ``good``
    clipped: StateTable | None = None  # samples are clipped where it is not ``good``
    fault: StateTable | None = None  # the sensor has failed where it is not ``good``


class VehicleTable(InputTable):
    """The signals of the vehicle; a ``track_section`` that is a number is that one always."""

    speed: SignalTable
    odometer: SignalTable
    distance: SignalTable
    track_section: SignalTable | int
    position_quality: SignalTable | None = None


class ClockTable(InputTable):
    """Where the sampling instants come from.

    ``canopen``: SYNC with a counter 1 + k mod 240 of the sampling intervals k since 1970, and TIME_OF_DAY. ``stamps``:
    the stamps of the log, which are the vehicle's clock then; ``reference`` is the message that comes first in each
    cycle.
    """

    kind: Literal["canopen", "stamps"]
    rate_hz: float = Field(ge=50.0, le=1000.0)
    reference: Text | None = None
    counter: SignalTable | None = None
    milliseconds: SignalTable | None = None
    days: SignalTable | None = None

    @model_validator(mode="after")
    def _check_kind(self) -> Self:
        needed = {"canopen": ("counter", "milliseconds", "days"), "stamps": ("reference",)}[self.kind]
        for name in ("reference", "counter", "milliseconds", "days"):
            if (getattr(self, name) is not None) != (name in needed):
                problem = "is needed" if name in needed else "has no meaning"
                raise field_error(f"{problem} where the kind is {self.kind!r}", name)
        interval = 1e9 / self.rate_hz
        if interval != round(interval):
            raise field_error(f"{self.rate_hz:g} Hz is no whole number of nanoseconds", "rate_hz")
        return self


class MappingFile(InputTable):
    """The whole mapping file."""

    dbc: Text
    vehicle_classes: list[Text] = Field(default_factory=list)
    clock: ClockTable
    vehicle: VehicleTable
    nodes: list[NodeTable] = Field(min_length=1, max_length=MAX_AXLES)

    @model_validator(mode="after")
    def _check_nodes(self) -> Self:
        numbers = [node.axle for node in self.nodes]
        for index, number in enumerate(numbers):
            if number in numbers[:index]:
                raise field_error(f"axle {number} is there twice", "nodes", index, "axle")
            sequence = self.nodes[index].sequence
            if sequence is not None and sequence.message != self.nodes[index].lateral.message:
                raise field_error("must be in the message of the lateral acceleration", "nodes", index, "sequence")
        return self

    @property
    def signals(self) -> list[tuple[Location, SignalTable]]:
        """All signals, and where in the file they are."""
        signals: list[tuple[Location, SignalTable]] = []
        tables: list[tuple[Location, InputTable]] = [(("clock",), self.clock), (("vehicle",), self.vehicle)]
        tables += [(("nodes", index), node) for index, node in enumerate(self.nodes)]
        for location, table in tables:
            for name in type(table).model_fields:
                value = getattr(table, name)
                if isinstance(value, SignalTable):
                    signals.append(((*location, name), value))
        return signals
