"""The newest measurements of a fleet, compared, with where their wheelsets ran."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence

from estimation.accuracy.fleet_accuracy import PlacedComparison
from estimation.jobs.steps.compared_measurements import ComparisonReader
from estimation.values.registry import Mounting
from fleet_db.storage import SqlUnitOfWork


def placed_comparisons(
    unit: SqlUnitOfWork, reader: ComparisonReader, keys: Sequence[tuple[str, int]]
) -> list[PlacedComparison]:
    """Return some measurements beside the estimates that belong to them, in their order.

    Parameters
    ----------
    unit
        Registry and estimates are read.
    reader
        Compares; of the same transaction.
    keys
        Wheelset and time of each measurement.
    """
    times: defaultdict[str, set[int]] = defaultdict(set)
    for serial, at_ns in keys:
        times[serial].add(at_ns)
    classes: dict[str, str] = {}
    found: dict[tuple[str, int], PlacedComparison] = {}
    for serial, wanted in times.items():
        measurements = [one for one in unit.registry.measured_profiles(serial) if one.at_ns in wanted]
        mountings = unit.registry.mountings(serial)
        for comparison in reader.of_wheelset(unit.registry.wheelset(serial), measurements):
            record = comparison.estimate.record
            at_ns = comparison.measurement.at_ns
            sections = () if record is None else tuple(sorted(record.track_versions))
            vehicle = _vehicle_at(mountings, at_ns)
            of_class = None if vehicle is None else _class_of(unit, vehicle, classes)
            found[serial, at_ns] = PlacedComparison(comparison, of_class, sections)
    return [found[key] for key in keys if key in found]


def _vehicle_at(mountings: Sequence[Mounting], at_ns: int) -> str | None:
    """Return the vehicle that a wheelset was mounted on, or had been last: profiles are measured in the depot too."""
    before = [one for one in mountings if one.from_ns <= at_ns]
    return max(before, key=lambda one: one.from_ns).vehicle if before else None


def _class_of(unit: SqlUnitOfWork, vehicle: str, known: dict[str, str]) -> str:
    if vehicle not in known:
        known[vehicle] = unit.registry.vehicle(vehicle).vehicle_class
    return known[vehicle]
