"""Mistakes in the registry, each with what undoes it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from bench.put_values import put_mountings
from estimation.values.registry import Mounting, Reprofiling
from fleet_db.records import Decision, RecordKind
from fleet_db.storage import SqlUnitOfWork
from fleet_db.stores.registry_history import RecordKey

SECTION, VEHICLE = "C-1", "C-1"
WHEELSETS = ("C-11", "C-12")
HOUR_NS = 3_600_000_000_000
UNDONE = Decision("chaos", "a mistake")

Undo = Callable[[SqlUnitOfWork], None]


def _mounting(unit: SqlUnitOfWork, serial: str) -> Mounting:
    return unit.registry.mountings(serial)[0]


def _void(kind: RecordKind, subject: str, at_ns: int | None = None) -> Undo:
    return lambda unit: void(unit, RecordKey(kind, subject, at_ns))


def void(unit: SqlUnitOfWork, key: RecordKey) -> None:
    """Void a record."""
    unit.corrections.void(key, UNDONE)


def swapped(unit: SqlUnitOfWork, rng: np.random.Generator) -> list[Undo]:  # noqa: ARG001 - as every mistake
    """Enter two wheelsets under each other's name; the right file puts it right."""
    first, second = (_mounting(unit, serial) for serial in WHEELSETS)
    put_mountings(unit, [replace(first, axle=second.axle), replace(second, axle=first.axle)])
    return []


def turned_round(unit: SqlUnitOfWork, rng: np.random.Generator) -> list[Undo]:
    """Enter a wheelset the other way round."""
    was = _mounting(unit, str(rng.choice(WHEELSETS)))
    unit.registry.add_mounting(replace(was, reversed=not was.reversed))
    return []


def other_mileage(unit: SqlUnitOfWork, rng: np.random.Generator) -> list[Undo]:
    """Enter another mileage of a wheelset."""
    was = _mounting(unit, str(rng.choice(WHEELSETS)))
    unit.registry.add_mounting(
        replace(was, wheelset_mileage_km=was.wheelset_mileage_km + float(rng.integers(1, 90000)))
    )
    return []


def ended_early(unit: SqlUnitOfWork, rng: np.random.Generator) -> list[Undo]:
    """End a mounting between two campaigns, and mount the wheelset again the other way round or at another mileage."""
    was = _mounting(unit, str(rng.choice(WHEELSETS)))
    end_ns = was.from_ns + int(rng.integers(1, 40)) * 24 * HOUR_NS
    unit.registry.add_mounting(replace(was, to_ns=end_ns))
    turned = bool(rng.integers(2))
    mileage_km = was.wheelset_mileage_km + (0.0 if turned else float(rng.integers(1, 90000)))
    other = replace(was, from_ns=end_ns, reversed=turned is not was.reversed, wheelset_mileage_km=mileage_km)
    unit.registry.add_mounting(other)
    return [_void(RecordKind.MOUNTING, other.wheelset, end_ns)]


def forgotten(unit: SqlUnitOfWork, rng: np.random.Generator) -> list[Undo]:
    """Take a mounting out that was right."""
    was = _mounting(unit, str(rng.choice(WHEELSETS)))
    key = RecordKey(RecordKind.MOUNTING, was.wheelset, was.from_ns)
    void(unit, key)
    return [lambda unit: _restored(unit, key)]


def never_reprofiled(unit: SqlUnitOfWork, rng: np.random.Generator) -> list[Undo]:
    """Enter a reprofiling that never was."""
    was = _mounting(unit, str(rng.choice(WHEELSETS)))
    at_ns = was.from_ns + int(rng.integers(1, 40)) * 24 * HOUR_NS
    unit.registry.add_reprofiling(Reprofiling(was.wheelset, at_ns, was.wheelset_mileage_km + 15_000.0))
    return [_void(RecordKind.REPROFILING, was.wheelset, at_ns)]


def other_radius(unit: SqlUnitOfWork, rng: np.random.Generator) -> list[Undo]:
    """Enter another nominal radius."""
    was = unit.registry.wheelset(str(rng.choice(WHEELSETS)))
    unit.registry.add_wheelset(replace(was, nominal_radius_m=was.nominal_radius_m - 0.02, mounting=None), 1)
    return []


def other_offsets(unit: SqlUnitOfWork, rng: np.random.Generator) -> list[Undo]:
    """Enter axles at other places."""
    was = unit.registry.vehicle(VEHICLE)
    moved = tuple(offset + float(rng.uniform(0.5, 3.0)) for offset in was.axle_offsets_m)
    unit.registry.add_vehicle(replace(was, axle_offsets_m=moved), 1)
    return []


def other_number(unit: SqlUnitOfWork, rng: np.random.Generator) -> list[Undo]:
    """Enter the section under another number."""
    unit.tracks.add_section(replace(unit.tracks.section(SECTION), number=int(rng.integers(100, 999))))
    return []


def no_section(unit: SqlUnitOfWork, rng: np.random.Generator) -> list[Undo]:  # noqa: ARG001 - as every mistake
    """Void the section."""
    key = RecordKey(RecordKind.SECTION, SECTION)
    void(unit, key)
    return [lambda unit: _restored(unit, key)]


def _restored(unit: SqlUnitOfWork, key: RecordKey) -> None:
    unit.corrections.restore(key, UNDONE)


MISTAKES = (
    swapped,
    never_reprofiled,
    turned_round,
    other_mileage,
    ended_early,
    forgotten,
    other_radius,
    other_offsets,
    other_number,
    no_section,
)


RESTORED = (forgotten, no_section)
"""Mistakes that are put right by restoring what was voided; the others need the right file, too."""
