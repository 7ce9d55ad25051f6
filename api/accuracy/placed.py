"""The newest measurements of a fleet, compared, with where their wheelsets ran."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from estimation.accuracy.fleet_accuracy import PlacedComparison
from estimation.errors import DamagedError
from estimation.jobs.steps.compared_measurements import ComparisonReader
from estimation.values.reasons import Reason
from estimation.values.registry import Mounting
from estimation.values.runs import code_of_error, first_line
from fleet_db.storage import SqlUnitOfWork


@dataclass(frozen=True, slots=True)
class Placed:
    """What was compared, and what could not be read.

    Attributes:
        rows: Measurements beside their estimates.
        unreadable: By wheelset: why none of its measurements is among the rows.
    """

    rows: list[PlacedComparison]
    unreadable: dict[str, Reason]


def placed_comparisons(unit: SqlUnitOfWork, reader: ComparisonReader, keys: Sequence[tuple[str, int]]) -> Placed:
    """Return some measurements beside the estimates that belong to them, in their order.

    A wheelset of which something stored is damaged is named, and keeps no other from being compared.

    Args:
        reader: Compares; of the same transaction.
    """
    times: defaultdict[str, set[int]] = defaultdict(set)
    for serial, at_ns in keys:
        times[serial].add(at_ns)
    classes: dict[str, str] = {}
    found: dict[tuple[str, int], PlacedComparison] = {}
    unreadable: dict[str, Reason] = {}
    for serial, wanted in times.items():
        try:
            found |= {(serial, at_ns): row for at_ns, row in _of_wheelset(unit, reader, serial, wanted, classes)}
        except DamagedError as error:
            unreadable[serial] = Reason(code_of_error(error), first_line(error))
    return Placed([found[key] for key in keys if key in found], unreadable)


def _of_wheelset(
    unit: SqlUnitOfWork, reader: ComparisonReader, serial: str, wanted: set[int], classes: dict[str, str]
) -> Iterator[tuple[int, PlacedComparison]]:
    measurements = [one for one in unit.registry.measured_profiles(serial) if one.at_ns in wanted]
    mountings = unit.registry.mountings(serial)
    for comparison in reader.of_wheelset(unit.registry.wheelset(serial), measurements):
        record = comparison.estimate.record
        at_ns = comparison.measurement.at_ns
        sections = () if record is None else tuple(sorted(record.track_versions))
        vehicle = _vehicle_at(mountings, at_ns)
        of_class = None if vehicle is None else _class_of(unit, vehicle, classes)
        yield at_ns, PlacedComparison(comparison, of_class, sections)


def _vehicle_at(mountings: Sequence[Mounting], at_ns: int) -> str | None:
    """Return the vehicle that a wheelset was mounted on, or had been last: profiles are measured in the depot too."""
    before = [one for one in mountings if one.from_ns <= at_ns]
    return max(before, key=lambda one: one.from_ns).vehicle if before else None


def _class_of(unit: SqlUnitOfWork, vehicle: str, known: dict[str, str]) -> str:
    if vehicle not in known:
        known[vehicle] = unit.registry.vehicle(vehicle).vehicle_class
    return known[vehicle]
