"""Mistakes in the registry, made at random and corrected: what is derived is as if they had never been made."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from api.comparison.trial import opened, receive
from api.pipeline import receiver, scheduled_jobs
from api.settings import Settings
from bench.chaos.final_state import final_state
from bench.chaos.run import ChaosSettings
from bench.counting import run
from bench.put_values import put_mountings
from bench.report import BenchRow
from bench.small_fleets import Workload, deployed, kept_for_ever, small_fleet
from estimation.jobs.job import JobContext
from estimation.values.registry import Mounting, Reprofiling
from estimation.values.units import HOUR_NS
from estimation.vehicle.vehicle_class import VehicleClass
from fleet_db.records import Decision, RecordKind
from fleet_db.storage import SqlStorage, SqlUnitOfWork
from fleet_db.stores.registry_history import RecordKey
from ingest.registry_file import load_registry
from ingest.simulator.fleet import prepare
from tests.postgres_server import stoppable_server

SECTION, VEHICLE = "C-1", "C-1"
WHEELSETS = ("C-11", "C-12")
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


def other_class(unit: SqlUnitOfWork, rng: np.random.Generator) -> list[Undo]:
    """Enter another yaw stiffness for the class of the vehicles."""
    was = unit.registry.vehicle_class(unit.registry.vehicle(VEHICLE).vehicle_class)
    assert was is not None
    parameters = was.vehicle_class.parameters
    stiffer = replace(parameters, yaw_stiffness=parameters.yaw_stiffness * float(rng.uniform(1.2, 2.0)))
    unit.registry.add_vehicle_class(replace(was.vehicle_class, parameters=stiffer), 1)
    return [lambda unit: _class_again(unit, was.vehicle_class)]


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


def _class_again(unit: SqlUnitOfWork, right: VehicleClass) -> None:
    unit.registry.add_vehicle_class(right, 2)


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
    other_class,
    other_offsets,
    other_number,
    no_section,
)


RESTORED = (forgotten, no_section)
"""Mistakes that are put right by restoring what was voided; the others need the right file, too."""


WINDOW_S = 30.0
WORN = {"1": ((0.1, 1.2), (2.4, 0.0))}  # mm, and by 100,000 km
TRACK = ("alignments in force", "suspension", "fleet alerts")
"""Not compared: what carries numbers of versions, or groups alerts by the times at which they opened."""

SHORT = 4
"""Up to so many mistakes no PostgreSQL server is started for them."""

FOUND_LATE = 0.8
"""Share of the mistakes that are found after they have had their effect."""


@dataclass(frozen=True)
class Deployment:
    """A database with its files, on which everything runs for real."""

    settings: Settings
    storage: SqlStorage
    context: JobContext
    registry: Path

    def to_rest(self) -> None:
        """Run all jobs twice: alerts follow what the first run found."""
        for job in (*scheduled_jobs(self.settings), *scheduled_jobs(self.settings)):
            run(job, self.context)

    def load(self) -> None:
        """Load the registry file, which is right."""
        with self.storage.write() as unit:
            load_registry(self.registry, unit, self.context.clock.now_ns())

    def derived(self) -> Mapping[str, str]:
        """Return digests of what is derived and served, without times of recording and numbers of versions."""
        return {name: digest for name, digest in final_state(self.storage).items() if name not in TRACK}


@contextmanager
def _deployment(settings: Settings, registry: Path) -> Iterator[Deployment]:
    with opened(settings) as (storage, context):
        yield Deployment(settings, storage, context, registry)


@dataclass(frozen=True, slots=True)
class Corrected:
    """A round: the mistake, whether it showed before it was corrected (None: no job ran), what is not as never made."""

    number: int
    name: str
    showed: bool | None
    wrong: tuple[str, ...]

    def __str__(self) -> str:
        """Return the round with what is wrong."""
        return f"round {self.number}: {', '.join(self.wrong)}"


def _differing(expected: Mapping[str, str], now: Mapping[str, str]) -> tuple[str, ...]:
    return tuple(sorted(name for name in expected if expected[name] != now[name]))


def _corrected(found: Deployment, number: int, rng: np.random.Generator, expected: Mapping[str, str]) -> Corrected:
    """Make the mistake of a round, correct it, and return what is not as where it was never made."""
    mistake = MISTAKES[number % len(MISTAKES)]
    with found.storage.write() as unit:
        undo = mistake(unit, rng)
    showed = None
    if rng.random() < FOUND_LATE:
        found.to_rest()
        showed = bool(_differing(expected, found.derived()))
    with found.storage.write() as unit:
        for step in undo:
            step(unit)
    if mistake not in RESTORED:
        found.load()
    found.to_rest()
    return Corrected(number, mistake.__name__, showed, _differing(expected, found.derived()))


def _rounds(settings: ChaosSettings, numbers: Sequence[int], server: str | None) -> Iterator[Corrected]:
    """Make mistakes one after another; one that leaves something wrong is followed by another deployment."""
    home = settings.folder / ("sqlite" if server is None else "postgresql") / "round"
    scenario = small_fleet("C", WORN, (2.0, 4.5), 1.5, km_between=30_000.0, seed=23)
    load = deployed(settings.folder, scenario, server, workers=1)
    chosen = load.received.model_copy(
        update={"window_length_s": WINDOW_S, "retention_file": kept_for_ever(settings.folder)}
    )
    never = Workload(chosen, load.recordings, server)
    registry = prepare(scenario, settings.folder / "registry")
    with _deployment(never.received, registry) as reference:
        receiver(never.received, reference.storage, reference.context.clock).reassembler.work_off()
        receive(never.recorded, never.received)
        reference.to_rest()
        expected = reference.derived()
    left = list(numbers)
    while left:
        with _deployment(never.copy(home / str(left[0])), registry) as mistaken:
            while left:
                number = left.pop(0)
                found = _corrected(mistaken, number, np.random.default_rng((settings.seed, number)), expected)
                yield found
                if found.wrong:
                    break


def rows(settings: ChaosSettings) -> Iterator[BenchRow]:
    """Make mistakes, half on each database or few on SQLite alone; compare with a state without them."""
    half = settings.size if settings.size <= SHORT else settings.size // 2
    outcomes = list(_rounds(settings, range(half), None))
    if half < settings.size:
        with stoppable_server() as server:
            outcomes += _rounds(settings, range(half, settings.size), server.url)
    late = [one for one in outcomes if one.showed is not None]
    silent = [f"round {one.number}, {one.name}" for one in late if not one.showed]
    shown = "; ".join((f"{len(late) - len(silent)} of {len(late)}", *silent))
    yield BenchRow("mistakes that showed before they were corrected", shown, "all", not silent)
    for name in dict.fromkeys(one.name for one in outcomes):
        yield _row(f"corrected: {name}", [one for one in outcomes if one.name == name])
    yield _row("mistakes in the registry, corrected, sqlite", outcomes[:half])
    if half < settings.size:
        yield _row("mistakes in the registry, corrected, postgresql", outcomes[half:])


def _row(what: str, outcomes: Sequence[Corrected]) -> BenchRow:
    wrong = [one for one in outcomes if one.wrong]
    measured = f"{len(outcomes) - len(wrong)} of {len(outcomes)} as never made"
    return BenchRow(what, "; ".join((measured, *map(str, wrong))), "all as never made", not wrong)
