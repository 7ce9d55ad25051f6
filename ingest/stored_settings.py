"""What windows rest on beside recordings and registry: their length and the buses of the vehicles.

Both are stored with the first recording. The length never changes after that. A bus may: it is a new version, and what
was assembled with the one before is assembled again.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace

from estimation.errors import CatalogueError, ParameterError
from fleet_db.storage import SqlStorage, SqlUnitOfWork
from fleet_db.stores.estimated_again import decode_undecoded
from fleet_db.stores.installation import LENGTH
from ingest.catalogue import Catalogue
from ingest.own_bus.bus import OwnBus

BUSES = "buses"
OTHERS = ""  # stands for the classes without a bus of their own
CHANGED = "the catalogue of its bus has changed"


@dataclass(frozen=True, slots=True)
class BusChoice:
    """The buses of a deployment: those of some classes, and the one of all other classes.

    Of the classes in ``missing``, and of all others where ``others_missing``, recordings were decoded with a mapping
    file that this process was not given.
    """

    others: Catalogue
    by_class: dict[str, OwnBus]
    missing: frozenset[str] = frozenset()
    others_missing: bool = False

    def of_class(self, vehicle_class: str | None) -> Catalogue:
        """Return the bus of a class; of a vehicle that the registry does not know, that of all other classes."""
        bus = self.others if vehicle_class is None else self.by_class.get(vehicle_class, self.others)
        if vehicle_class in self.missing or (self.others_missing and bus is self.others):
            raise ParameterError(
                f"recordings of class {vehicle_class!r} were decoded with a mapping file that is not given here:"
                " name it in TREADWATCH_CATALOGUES, or with --catalogue",
                field="catalogue",
            )
        return bus

    def of_vehicle(self, class_of: Callable[[str], str | None], vehicle: str) -> Catalogue:
        """Return the bus of a vehicle; ``class_of`` gives the class of a vehicle, and is asked where that decides."""
        return self.of_class(class_of(vehicle)) if self.by_class or self.missing or self.others_missing else self.others


def bus_choice(shipped: Catalogue, buses: Sequence[OwnBus]) -> BusChoice:
    """Return the choice among buses; the shipped one is that of classes without a bus of their own."""
    by_class: dict[str, OwnBus] = {}
    others = [bus for bus in buses if not bus.vehicle_classes]
    if len(others) > 1:
        raise CatalogueError("two mapping files name no class: of which vehicles are they?", field="vehicle_classes")
    for bus in buses:
        for code in bus.vehicle_classes:
            if code in by_class:
                raise CatalogueError(f"class {code!r} is in two mapping files", field="vehicle_classes")
            by_class[code] = bus
    return BusChoice(others[0] if others else shipped, by_class)


@dataclass(frozen=True, slots=True)
class StoredBus:
    """The bus with which recordings were decoded: digest of its messages, and whether a mapping file described it."""

    digest: str
    own: bool


def claim(storage: SqlStorage, buses: BusChoice, length_ns: int, now_ns: int) -> BusChoice:
    """Store what this process assembles windows with; return its buses, without those that are not to be guessed.

    Where a bus is not the one before, its vehicles are assembled again. Where a mapping file described it and this
    process has none for it, recordings of its vehicles are left to a process that has.
    """
    with storage.read() as unit:
        unit.settings.check_window_length(length_ns)
        stored = _stored_buses(unit) if unit.settings.get(LENGTH) == str(length_ns) else None
    chosen: dict[str, Catalogue] = {OTHERS: buses.others, **buses.by_class}
    given = {
        name: StoredBus(hashlib.sha256(repr(_plain(bus)).encode()).hexdigest(), isinstance(bus, OwnBus))
        for name, bus in chosen.items()
    }
    if stored is None or _changed(stored, given):
        with storage.write() as unit:
            unit.settings.alone()
            unit.settings.check_window_length(length_ns)
            stored = (_stored_buses(unit) or {}) if unit.settings.in_use() else {}
            changed = _changed(stored, given)
            if stored:
                named = frozenset({*stored, *given})
                for vehicle in sorted({code for name in changed for code in _vehicles(unit, name, named)}):
                    unit.stale_spans.add(vehicle, None, None, CHANGED)
                    decode_undecoded(unit.chunks, vehicle, CHANGED, now_ns)
            stored |= {name: given[name] for name in changed}
            unit.settings.put(LENGTH, str(length_ns), now_ns)
            text = json.dumps({name: {"digest": bus.digest, "own": bus.own} for name, bus in sorted(stored.items())})
            unit.settings.put(BUSES, text, now_ns)
    missing = {name for name, bus in stored.items() if bus.own and not (name in given and given[name].own)}
    return replace(buses, missing=frozenset(missing - {OTHERS}), others_missing=OTHERS in missing)


def _changed(stored: Mapping[str, StoredBus], given: Mapping[str, StoredBus]) -> list[str]:
    """Return the classes whose bus is another one than before; the shipped one does not replace one's own."""
    kept = {name for name, bus in stored.items() if bus.own}
    return [name for name, bus in given.items() if stored.get(name) != bus and (bus.own or name not in kept)]


def _vehicles(unit: SqlUnitOfWork, name: str, named: frozenset[str]) -> Iterator[str]:
    if name != OTHERS:
        yield from (vehicle.code for vehicle in unit.registry.vehicles_of_class(name))
        return
    for fleet in unit.registry.fleets():
        for vehicle in unit.registry.vehicles_page(fleet.code, None, 1_000_000):
            if vehicle.vehicle_class not in named:
                yield vehicle.code


def _stored_buses(unit: SqlUnitOfWork) -> dict[str, StoredBus] | None:
    stored = unit.settings.get(BUSES)
    return None if stored is None else {name: StoredBus(**bus) for name, bus in json.loads(stored).items()}


def _plain(value: object) -> object:
    """Return what decoding takes from a bus; the order of messages in a file does not matter."""
    if is_dataclass(value):
        names = [field.name for field in fields(value) if field.name != "vehicle_classes"]
        return [(name, _plain(getattr(value, name))) for name in names]
    if isinstance(value, Mapping):
        return sorted((key, _plain(part)) for key, part in value.items())
    return [_plain(part) for part in value] if isinstance(value, (list, tuple)) else value
