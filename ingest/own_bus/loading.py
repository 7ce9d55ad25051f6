"""From a DBC file and its mapping file to a bus: every signal found, in a unit and range that can be used."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

from estimation.errors import CatalogueError, ParameterError
from ingest.catalogue import NO_SCALE, MessagePlan, SignalPlan, parse_dbc, plan_of, raw_range
from ingest.frames import DATA_BYTES, EXTENDED_FLAG
from ingest.input_file import InputFile, Location, read_toml
from ingest.own_bus.bus import (
    QUANTITIES,
    CanopenClock,
    MappingFile,
    NodeTable,
    OwnBus,
    OwnMessage,
    OwnNode,
    OwnVehicle,
    SensorTable,
    SignalBits,
    SignalReference,
    SignalTable,
    StampClock,
    StateReference,
    StateTable,
)
from ingest.units import DERIVATIVES, Quantity, unit_of

FIRST_KEY = 1 << 32  # behind every identifier with its flags
KIND = "OWN"
WORD_BITS = 64
EXACT_BITS = 53  # whole numbers that float64 holds
FLOAT_BITS = (32, 64)

RANGES: Mapping[Quantity, tuple[float, float]] = MappingProxyType(
    {
        Quantity.ACCELERATION: (2.0, 0.05),
        Quantity.ANGULAR_ACCELERATION: (5.0, 0.05),
        Quantity.ANGULAR_RATE: (0.1, 2e-3),
        Quantity.ANGLE: (2e-3, 2e-5),
        Quantity.SPEED: (15.0, 0.3),
        Quantity.LENGTH: (1000.0, 1000.0),
    }
)
"""What a signal must reach, and its largest count, in SI: less, and it cannot measure what it is to measure."""

LARGEST_POSITION_COUNT = 1.0  # m


def load_own_bus(path: Path) -> OwnBus:
    """Read a mapping file and the DBC file beside it.

    Raises CatalogueError, with file, line and field, where a signal cannot be read or cannot measure what it is to.
    """
    toml = read_toml(path, CatalogueError)
    mapping = toml.parse(MappingFile)
    dbc = path.parent / mapping.dbc
    database = parse_dbc(dbc)
    builder = _Builder(toml, {message.name: message for message in database.messages})
    references = {location: builder.reference(location, table) for location, table in mapping.signals}
    nodes = tuple(_node(index, node, references, builder) for index, node in enumerate(mapping.nodes))
    section = mapping.vehicle.track_section
    vehicle = OwnVehicle(
        speed=references["vehicle", "speed"],
        odometer=references["vehicle", "odometer"],
        distance=references["vehicle", "distance"],
        track_section=section if isinstance(section, int) else references["vehicle", "track_section"],
        position_quality=references.get(("vehicle", "position_quality")),
    )
    clock: CanopenClock | StampClock
    if mapping.clock.kind == "canopen":
        clock = CanopenClock(*(references["clock", name] for name in ("counter", "milliseconds", "days")))
    else:
        clock = StampClock(builder.identifier(str(mapping.clock.reference), ("clock", "reference")))
    multiplexers = {
        _identifier(message): tuple(
            sorted({int(v) for signal in message.signals for v in signal.multiplexer_ids or []})
        )
        for message in database.messages
    }
    return OwnBus(
        messages=MappingProxyType({key: message.plan for key, message in builder.messages.items()}),
        sample_interval_ns=round(1e9 / mapping.clock.rate_hz),
        own=MappingProxyType(builder.messages),
        lengths=MappingProxyType({_identifier(message): message.length for message in database.messages}),
        multiplexers=MappingProxyType(multiplexers),
        clock=clock,
        vehicle=vehicle,
        nodes=nodes,
        vehicle_classes=tuple(mapping.vehicle_classes),
    )


def _node(index: int, node: NodeTable, references: Mapping[Location, SignalReference], builder: _Builder) -> OwnNode:
    def state(name: str) -> StateReference | None:
        table: StateTable | None = getattr(node, name)
        if table is None:
            return None
        signal = references["nodes", index, name]
        if not signal.plan.raw_minimum <= table.good <= signal.plan.raw_maximum:
            reason = f"{table.good} is no value of signal {table.signal}"
            raise builder.toml.error(reason, ("nodes", index, name, "good"))
        return StateReference(signal, table.good)

    sensors = [references["nodes", index, name] for name in ("lateral", "yaw", "roll", "mass_lateral")]
    return OwnNode(
        axle=node.axle,
        sensors=(sensors[0], sensors[1], sensors[2], sensors[3]),
        sequence=references.get(("nodes", index, "sequence")),
        valid=state("valid"),
        clipped=state("clipped"),
        fault=state("fault"),
    )


@dataclass
class _Builder:
    toml: InputFile
    database: Mapping[str, Any]
    messages: dict[int, OwnMessage] = field(default_factory=dict)
    _keys: dict[tuple[str, int | None], int] = field(default_factory=dict)

    def identifier(self, name: str, location: Location) -> int:
        """Return the identifier of a message, with the flag of extended ones."""
        return _identifier(self._message(name, location))

    def reference(self, location: Location, table: SignalTable) -> SignalReference:
        """Return a signal in SI, its message among those that are decoded."""
        message = self._message(table.message, (*location, "message"))
        signal = next((item for item in message.signals if item.name == table.signal), None)
        if signal is None:
            names = ", ".join(item.name for item in message.signals)
            raise self.toml.error(
                f"message {message.name} has no signal {table.signal!r}; it has {names}", (*location, "signal")
            )
        value = self._multiplexer_value(message, signal, table, location)
        key = self._keys.setdefault((message.name, value), FIRST_KEY + len(self._keys))
        if key not in self.messages:
            try:
                self.messages[key] = _own_message(message, value, key)
            except ParameterError as error:
                raise self.toml.error(f"message {message.name}: {error}", (*location, "message")) from error
        plan = self.messages[key].plan
        column = plan.names.index(signal.name)
        reference = self._in_si(
            location, table, SignalReference(key, column, plan.signals[column], signal.is_float, 1.0, 0.0)
        )
        self._check_range(location, reference)
        return reference

    def _message(self, name: str, location: Location) -> Any:  # noqa: ANN401 - cantools is untyped
        message = self.database.get(name)
        if message is None:
            raise self.toml.error(f"the DBC file has no message {name!r}", location)
        if message.is_fd or message.length > DATA_BYTES:
            raise self.toml.error(f"message {name} has more than 8 bytes: CAN FD is not read", location)
        return message

    def _multiplexer_value(
        self,
        message: Any,  # noqa: ANN401 - cantools is untyped
        signal: Any,  # noqa: ANN401 - cantools is untyped
        table: SignalTable,
        location: Location,
    ) -> int | None:
        values = list(signal.multiplexer_ids or [])
        if not values:
            if table.multiplexer is not None:
                raise self.toml.error(f"signal {signal.name} is not multiplexed", (*location, "multiplexer"))
            return None
        top = [item for item in message.signals if item.is_multiplexer]
        if len(top) != 1 or signal.multiplexer_signal != top[0].name or len(values) != 1:
            raise self.toml.error(f"signal {signal.name} is multiplexed more than once", (*location, "signal"))
        if table.multiplexer not in {None, values[0]}:
            raise self.toml.error(
                f"signal {signal.name} is sent where {top[0].name} is {values[0]}, not {table.multiplexer}",
                (*location, "multiplexer"),
            )
        return int(values[0])

    def _in_si(self, location: Location, table: SignalTable, reference: SignalReference) -> SignalReference:
        allowed = QUANTITIES.get(str(location[-1]))
        scale, offset, times, limit = reference.plan.scale, reference.plan.offset, 0, math.inf
        if allowed is not None and location[-1] not in {"milliseconds", "days"}:
            written = table.unit if table.unit is not None else reference.plan.unit
            try:
                unit = unit_of(written, allowed)
            except ParameterError as error:
                where = "of the DBC file " if table.unit is None else ""
                raise self.toml.error(f"signal {table.signal}: unit {where}{error}", (*location, "unit")) from error
            scale, offset, times = scale * unit.factor, offset * unit.factor, DERIVATIVES.get(unit.quantity, 0)
            if isinstance(table, SensorTable):
                sign = -1.0 if table.turned else 1.0
                scale, offset = sign * scale, sign * offset
                limit = math.inf if table.limit is None else table.limit * unit.factor
            self._check_count(location, table, abs(scale), reference, unit.quantity)
        return replace(reference, scale=scale, offset=offset, derivatives=times, limit=limit)

    def _check_count(
        self, location: Location, table: SignalTable, count: float, reference: SignalReference, quantity: Quantity
    ) -> None:
        if quantity not in RANGES or reference.is_float:
            return
        largest = LARGEST_POSITION_COUNT if location[-1] == "distance" else RANGES[quantity][1]
        if count > largest:
            raise self.toml.error(
                f"signal {table.signal}: one count is {count:.3g} in SI, {largest:g} at most is useful: a wrong unit?",
                location,
            )

    def _check_range(self, location: Location, reference: SignalReference) -> None:
        name = str(location[-1])
        quantity = (
            list(DERIVATIVES)[reference.derivatives]
            if name in {"yaw", "roll"}
            else QUANTITIES.get(name, (Quantity.NUMBER,))[0]
        )
        if quantity not in RANGES or name == "odometer" or reference.is_float:
            return
        raw_ends = reference.plan.raw_minimum, reference.plan.raw_maximum
        ends = [raw * reference.scale + reference.offset for raw in raw_ends]
        least = RANGES[quantity][0]
        signed = quantity not in {Quantity.SPEED, Quantity.LENGTH}
        if max(ends) < least or (signed and min(ends) > -least):
            span = f"{min(ends):.4g} to {max(ends):.4g}"
            sign = "+-" if signed else ""
            raise self.toml.error(
                f"signal {reference.plan.name}: its range is {span} in SI, {sign}{least:g} is needed: a wrong unit?",
                location,
            )


def _identifier(message: Any) -> int:  # noqa: ANN401 - cantools is untyped
    return int(message.frame_id) | (EXTENDED_FLAG if message.is_extended_frame else 0)


def _own_message(message: Any, value: int | None, key: int) -> OwnMessage:  # noqa: ANN401 - cantools is untyped
    multiplexer = next((item for item in message.signals if item.is_multiplexer), None)
    signals = [item for item in message.signals if not item.multiplexer_ids or item.multiplexer_ids == [value]]
    return OwnMessage(
        plan=MessagePlan(
            name=message.name,
            kind=KIND,
            node=None,
            arbitration_id=key,
            length=message.length,
            cycle_ns=int(message.cycle_time or 0) * 1_000_000,
            signals=tuple(_plan(item) for item in signals),
        ),
        bits=tuple(_bits(item) for item in signals),
        identifier=_identifier(message),
        multiplexer=None if value is None or multiplexer is None else (_plan(multiplexer), _bits(multiplexer)),
        multiplexer_value=value or 0,
    )


def _plan(signal: Any) -> SignalPlan:  # noqa: ANN401 - cantools is untyped
    if signal.length > EXACT_BITS and not signal.is_float:
        raise ParameterError(f"{signal.length} bits, at most {EXACT_BITS} are read", field=signal.name)
    if signal.is_float and signal.length not in FLOAT_BITS:
        raise ParameterError("a float has 32 or 64 bits", field=signal.name)
    if not signal.scale:
        raise ParameterError(NO_SCALE, field=signal.name)
    lowest, highest = raw_range(signal)
    minimum, maximum = lowest, highest
    if signal.minimum is not None and signal.maximum is not None and not signal.is_float:
        ends = [round((float(end) - signal.offset) / signal.scale) for end in (signal.minimum, signal.maximum)]
        minimum, maximum = max(min(ends), lowest), min(max(ends), highest)
    if minimum >= maximum:
        raise ParameterError("the limits do not fit the number of bits", field=signal.name)
    return plan_of(signal, minimum, maximum, clips=False)


def _bits(signal: Any) -> SignalBits:  # noqa: ANN401 - cantools is untyped
    if signal.byte_order == "little_endian":
        return SignalBits(big_endian=False, shift=signal.start, is_float=signal.is_float)
    byte, bit = divmod(signal.start, 8)  # DBC gives the highest bit of a big-endian signal
    shift = WORD_BITS - (8 * byte + 7 - bit) - signal.length
    return SignalBits(big_endian=True, shift=shift, is_float=signal.is_float)
