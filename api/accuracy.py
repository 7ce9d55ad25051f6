"""The newest measurements of a fleet beside their estimates, and contact geometries that were computed before."""

from __future__ import annotations

import hashlib
from collections import OrderedDict, defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from threading import Lock

from estimation.accuracy.fleet_accuracy import PlacedComparison
from estimation.accuracy.wheel_contact import RailShare, WheelContact, WheelPair, wheel_contact
from estimation.errors import DamagedError
from estimation.jobs.steps.measured_wheelsets import ComparisonReader
from estimation.values.reasons import Reason
from estimation.values.runs import code_of_error, first_line
from fleet_db.storage import SqlUnitOfWork


@dataclass(frozen=True, slots=True)
class Placed:
    """What was compared, and what could not be read."""

    rows: list[PlacedComparison]
    unreadable: dict[str, Reason]  # by wheelset: why none of its measurements is among the rows


def placed_comparisons(unit: SqlUnitOfWork, reader: ComparisonReader, keys: Sequence[tuple[str, int]]) -> Placed:
    """Return some measurements beside the estimates that belong to them, in their order.

    A wheelset of which something stored is damaged is named, and keeps no other from being compared.
    """
    times: defaultdict[str, set[int]] = defaultdict(set)
    for serial, at_ns in keys:
        times[serial].add(at_ns)
    classes: dict[str, str] = {}
    rows: dict[tuple[str, int], PlacedComparison] = {}
    unreadable: dict[str, Reason] = {}
    for serial, wanted in times.items():
        try:
            rows |= {(serial, at_ns): row for at_ns, row in _of_wheelset(unit, reader, serial, wanted, classes)}
        except DamagedError as error:
            unreadable[serial] = Reason(code_of_error(error), first_line(error))
    return Placed([rows[key] for key in keys if key in rows], unreadable)


def _of_wheelset(
    unit: SqlUnitOfWork, reader: ComparisonReader, serial: str, wanted: set[int], classes: dict[str, str]
) -> Iterator[tuple[int, PlacedComparison]]:
    measurements = [measured for measured in unit.registry.measured_profiles(serial) if measured.at_ns in wanted]
    mountings = unit.registry.mountings(serial)
    for comparison in reader.of_wheelset(unit.registry.wheelset(serial), measurements):
        record = comparison.estimate.record
        at_ns = comparison.measurement.at_ns
        sections = () if record is None else tuple(sorted(record.track_versions))
        before = [mounting for mounting in mountings if mounting.from_ns <= at_ns]  # or was last: in the depot too
        vehicle = max(before, key=lambda mounting: mounting.from_ns).vehicle if before else None
        if vehicle is not None and vehicle not in classes:
            classes[vehicle] = unit.registry.vehicle(vehicle).vehicle_class
        of_class = None if vehicle is None else classes[vehicle]
        yield at_ns, PlacedComparison(comparison, of_class, sections)


MOST_KEPT = 2048  # each takes some 8 kB


@dataclass(frozen=True, slots=True)
class ContactCache:
    """The contact geometries that were asked for last, in one process; safe in threads."""

    _kept: OrderedDict[str, WheelContact | Reason] = field(default_factory=OrderedDict)
    _lock: Lock = field(default_factory=Lock)

    def contact(self, wheels: WheelPair, rails: Sequence[RailShare]) -> WheelContact | Reason:
        """Return the contact geometry of two wheels on rails, or why there is none."""
        key = _digest(wheels, rails)
        with self._lock:
            if key in self._kept:
                self._kept.move_to_end(key)
                return self._kept[key]
        contact = wheel_contact(wheels, rails)
        with self._lock:
            self._kept[key] = contact
            while len(self._kept) > MOST_KEPT:
                self._kept.popitem(last=False)
        return contact


def _digest(wheels: WheelPair, rails: Sequence[RailShare]) -> str:
    digest = hashlib.blake2b(repr((wheels.nominal_radius, wheels.std, tuple(rails))).encode(), digest_size=16)
    for wheel in (wheels.left, wheels.right):
        for values in (wheel.y, wheel.z, wheel.slope):
            digest.update(values.tobytes())
        digest.update(b"/")
    return digest.hexdigest()
