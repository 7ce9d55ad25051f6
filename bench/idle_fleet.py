"""A fleet whose windows are all estimated: rows of a small real deployment, copied to 1,000 vehicles in bulk.

One wheelset runs through receiver and jobs for ``DAYS`` days (``bench.wheelset_year``). Its windows, positions, bin
tables, roll-ups, geometries, trends and second opinions (``bench.idle_fleet``) are copied for every axle of every
vehicle; registry, sections, alignments and epochs are written through the stores, as they are made otherwise. Of packed
sums, of which a window has 50 kB and which no idle run reads, the copies have the first ``KEPT_BYTES``: about what
databases keep in the row of such a value.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from sqlalchemy import ColumnElement, Connection, Insert, Table, case, func, insert, literal, select

from api.settings import Settings
from bench.standing_clock import StandingClock
from bench.wheelset_recording import recorded
from bench.wheelset_year import SERIAL, WheelsetYear
from estimation.jobs import refresh_rails, refresh_signatures
from estimation.jobs.catalogue import ALL_STAGES, job_named
from estimation.jobs.job import JobContext, run_job
from estimation.jobs.settings import JobSettings
from estimation.jobs.steps.assumptions import ClassLookup
from estimation.jobs.steps.epoch_inputs import FileLookup, given
from estimation.jobs.steps.signature_windows import ASSUMED
from estimation.values.registry import FleetRecord, Mounting, VehicleRecord
from estimation.values.runs import JobTrigger, Mark
from estimation.values.track import AlignmentSource, FoldState, TrackEpoch
from estimation.values.units import DAY_NS
from fleet_db.due import DUE
from fleet_db.rows import table_of
from fleet_db.storage import SqlStorage, SqlUnitOfWork
from fleet_db.tables.operation import ResultRow
from fleet_db.tables.recordings import ChunkRow
from fleet_db.tables.registry import MountingRow
from fleet_db.tables.track import TrackEpochRow, TrackEpochWindowRow, WindowPositionRow
from fleet_db.tables.windows import (
    RailCellRow,
    RollingSumsRow,
    RollUpRow,
    RollUpStateRow,
    SectionAdhesionRow,
    WearSignatureRow,
    WindowAdhesionRow,
    WindowBinTableRow,
    WindowDamperRow,
    WindowRow,
)

KEPT_BYTES = 500
CREEP, DAMPERS = table_of(WindowAdhesionRow), table_of(WindowDamperRow)
SIGNATURES, CELLS = table_of(WearSignatureRow), table_of(RailCellRow)
FRICTION = table_of(SectionAdhesionRow)


def opinions_copied(mounting: Mounting, sections: Sequence[str]) -> Iterator[Insert]:
    """Yield statements that give a wheelset the second opinions of the model."""
    wheelset, vehicle = literal(mounting.wheelset), literal(mounting.vehicle)
    for table, section in ((CREEP, "track_section"), (SIGNATURES, "section")):
        day = (table.c.start_ns // DAY_NS) % len(sections)
        place = case(*((day == at, literal(code)) for at, code in enumerate(sections)))
        yield _copy(table, {"wheelset": wheelset, "vehicle": vehicle, section: place})
    gear: dict[str, ColumnElement[Any]] = {"vehicle": vehicle, "first_axle": literal(mounting.axle)}
    yield _copy(DAMPERS, {"wheelset": wheelset, **gear})
    by_interval = CELLS.c.mileage_interval % len(sections)
    place = case(*((by_interval == at, literal(code)) for at, code in enumerate(sections)))
    yield _copy(CELLS, {"wheelset": wheelset, "section": place})


def put_friction(connection: Connection, sections: Sequence[str]) -> None:
    """Give sections the friction of the model's section."""
    model = connection.scalar(select(func.min(FRICTION.c.track_section)))
    for code in sections:
        connection.execute(_copy(FRICTION, {"track_section": literal(code)}, FRICTION.c.track_section == model))


def note_opinions(context: JobContext, storage: SqlStorage) -> None:
    """Note that the jobs of the second opinions have looked at everything, as they do it themselves."""
    with storage.read() as unit:
        seen = {}
        for stage in (refresh_rails.OF_WHEELSETS, refresh_rails.OF_ALL, ASSUMED, refresh_signatures.OF_ALL):
            inputs = stage.inputs(context)
            due = unit.marks.due(inputs, context.clock.now_ns())
            seen[inputs] = {subject: Mark(state.seen, "") for subject, state in due.items()}
    with storage.write() as unit:
        for inputs, marks in seen.items():
            unit.marks.note(inputs, marks)


DAYS = 38
FLEETS, AXLES = 10, 4
SECTIONS_OF_A_VEHICLE = 4
"""On so many sections a vehicle runs, one after the other by day."""

FASTER_OF = 8
"""One vehicle in so many is faster than the others: its limit of the conicity is lower."""

FASTER = 1.6
TOGETHER = 50  # vehicles written in one transaction
OPINIONS = ("refresh_adhesion", "refresh_signatures", "refresh_rails")
SUMS = {"window_bin_tables": ("packed",), "rolling_sums": ("packed",), "roll_up_states": ("earlier",)}
SUMS |= {"roll_ups": ("plain", "forgetting")}
SUMS |= dict.fromkeys((CREEP.name, DAMPERS.name, SIGNATURES.name, FRICTION.name), ("packed",))
WINDOWS, POSITIONS, TABLES = table_of(WindowRow), table_of(WindowPositionRow), table_of(WindowBinTableRow)
ROLL_UPS, MEMBERS, EPOCHS = table_of(RollUpRow), table_of(TrackEpochWindowRow), table_of(TrackEpochRow)
MOUNTINGS, CHUNKS = table_of(MountingRow), table_of(ChunkRow)
OF_WHEELSET, RESULTS = (table_of(RollUpStateRow), table_of(RollingSumsRow)), table_of(ResultRow)


@dataclass(frozen=True, slots=True)
class FleetSize:
    """Of how many vehicles and sections the fleet is."""

    vehicles: int = 1000
    sections: int = 100

    def vehicle(self, number: int) -> str:
        """Return the code of a vehicle."""
        return f"V-{number:04d}"

    def serial(self, number: int, axle: int) -> str:
        """Return the serial of the wheelset at an axle of a vehicle."""
        return f"W-{number:04d}-{axle}"

    def section(self, number: int) -> str:
        """Return the code of a section."""
        return f"S-{number:03d}"

    def sections_of(self, vehicle: int) -> list[str]:
        """Return the sections that a vehicle runs on, in their order."""
        first = vehicle * SECTIONS_OF_A_VEHICLE
        return [self.section((first + place) % self.sections) for place in range(SECTIONS_OF_A_VEHICLE)]


def fill(context: JobContext, storage: SqlStorage, settings: Settings, size: FleetSize) -> int:
    """Fill an empty database; return our time at the end, ns UTC."""
    end_ns = WheelsetYear(context, storage, recorded(context, storage, settings)).put(1, DAYS)
    for name in OPINIONS:
        run_job(job_named(name), replace(context, clock=StandingClock(end_ns)), JobTrigger.CLI)
    with storage.write() as unit:
        _sections(unit, size)
    for first in range(0, size.vehicles, TOGETHER):
        with storage.write() as unit:
            _vehicles(unit, size, range(first, min(size.vehicles, first + TOGETHER)))
    with storage.write() as unit:
        put_friction(unit.connection, [size.section(number) for number in range(size.sections)])
        _epochs(unit, context.settings)
        _members(unit, context.settings)
        _see(unit, context)
        unit.stale_spans.remove(unit.stale_spans.all())
    with storage.engine.connect().execution_options(isolation_level="AUTOCOMMIT") as connection:
        connection.exec_driver_sql("ANALYZE")
    return end_ns


def _sections(unit: SqlUnitOfWork, size: FleetSize) -> None:
    """Put the sections on file: each second one is surveyed, the fleet has found the alignment of the others."""
    (model,) = unit.tracks.sections()
    alignment = unit.tracks.alignment(model.code)
    assert alignment is not None
    for number in range(size.sections):
        code = size.section(number)
        unit.tracks.add_section(replace(model, code=code, number=1000 + number, name=code))
        if number % 2:
            unit.tracks.add_alignment(replace(alignment, section=code))
        else:
            found = replace(alignment, section=code, source=AlignmentSource.FLEET)
            unit.tracks.add_alignment(found, recorded_ns=1)


def _vehicles(unit: SqlUnitOfWork, size: FleetSize, numbers: Sequence[int]) -> None:
    """Put vehicles on file with their wheelsets, and copy what there is of the model for each of these."""
    model = unit.registry.wheelset(SERIAL)
    assert model.mounting is not None
    vehicle = unit.registry.vehicle(model.mounting.vehicle)
    for number in numbers:
        sections = size.sections_of(number)
        fleet = f"F-{number % FLEETS:02d}"
        unit.registry.add_fleet(FleetRecord(fleet, fleet))
        faster = FASTER if number % FASTER_OF == 0 else 1.0
        unit.registry.add_vehicle(
            VehicleRecord(
                *(size.vehicle(number), fleet, vehicle.vehicle_class, AXLES),
                *(faster * vehicle.max_speed_m_s, (2.0, 4.5, 14.0, 16.5)),
            )
        )
        for axle in range(1, AXLES + 1):
            serial = size.serial(number, axle)
            mounting = replace(model.mounting, wheelset=serial, vehicle=size.vehicle(number), axle=axle)
            unit.registry.add_wheelset(replace(model, serial=serial, fleet=fleet, mounting=mounting))
            for statement in (*_copied(size, number, mounting), *opinions_copied(mounting, sections)):
                unit.connection.execute(statement)
        unit.connection.execute(insert(CHUNKS), list(_chunks(unit.connection, size.vehicle(number))))


def _copied(size: FleetSize, number: int, mounting: Mounting) -> Iterator[Insert]:
    """Yield statements that give a wheelset what the model has, on the sections of its vehicle."""
    sections = size.sections_of(number)
    day = (WINDOWS.c.start_ns // DAY_NS) % SECTIONS_OF_A_VEHICLE
    place = case(*((day == at, literal(code)) for at, code in enumerate(sections)))
    own = {"vehicle": literal(mounting.vehicle), "axle": literal(mounting.axle), "track_section": place}
    wheelset = {"wheelset": literal(mounting.wheelset)}
    yield _copy(WINDOWS, wheelset | own)
    yield _copy(POSITIONS, wheelset)
    yield _copy(ROLL_UPS, wheelset)
    yield _copy(TABLES, wheelset | {"track_version": literal(1)})
    yield _copy(DUE, wheelset | {"vehicle": literal(mounting.vehicle)})
    yield _copy(RESULTS, {"subject": literal(mounting.wheelset)})
    for table in OF_WHEELSET:
        yield _copy(table, wheelset)


def _copy(table: Table, own: Mapping[str, object], rows: ColumnElement[bool] | None = None) -> Insert:
    """Return a statement that copies rows, by default those of the model, with some values of their own."""
    packed = SUMS.get(table.name, ())
    values = {name: func.substr(table.c[name], 1, KEPT_BYTES) for name in packed} | dict(own)
    numbered = {column.name for column in table.primary_key if column.autoincrement is True} | {"number", "result_id"}
    names = [column.name for column in table.columns if column.name not in numbered]
    if rows is None:
        rows = table.c["subject" if table is RESULTS else "wheelset"] == SERIAL
    chosen = select(*(values.get(name, table.c[name]) for name in names)).where(rows)
    return insert(table).from_select(names, chosen)


def _chunks(connection: Connection, vehicle: str) -> Iterator[dict[str, object]]:
    model = dict(connection.execute(select(CHUNKS).order_by(CHUNKS.c.digest).limit(1)).mappings().one())
    for day in range(DAYS):
        shift_ns = day * DAY_NS
        ends = {name: model[name] + shift_ns for name in ("first_ns", "last_ns") if model[name] is not None}
        yield model | ends | {"vehicle": vehicle, "digest": f"{vehicle}-{day:03d}".ljust(64, "0")}


def _see(unit: SqlUnitOfWork, context: JobContext) -> None:
    for stage in ALL_STAGES:
        inputs = stage.inputs(context)
        due = unit.marks.due(inputs, 0)
        unit.marks.note(inputs, {subject: Mark(state.seen, "") for subject, state in due.items()})


def _epochs(unit: SqlUnitOfWork, settings: JobSettings) -> None:
    """Store an epoch of each day on each section, as the job would have made it of the windows of that day."""
    day = (WINDOWS.c.start_ns // DAY_NS).label("day")
    counted = select(WINDOWS.c.track_section, day, func.count(), func.max(WINDOWS.c.start_ns))
    days: dict[str, list[tuple[int, int]]] = {}
    for section, _, windows, last_ns in unit.connection.execute(
        counted.where(WINDOWS.c.track_section.like("S-%")).group_by(WINDOWS.c.track_section, day).order_by(day)
    ):
        days.setdefault(section, []).append((windows, last_ns))
    records = {section.code: section for section in unit.tracks.sections()}
    for code, found in days.items():
        basis, before = given(unit, records[code], settings)
        for number, (windows, last_ns) in enumerate(found, start=1):
            after = FoldState(1, 1)
            epoch = TrackEpoch(
                code, number, before.key(basis), "d" * 64, last_ns, windows, waits=False, after=after,
                estimated_on=1, report=0, recorded_ns=last_ns,
            )  # fmt: skip
            unit.epochs.put(epoch, [])
            before = after


def _members(unit: SqlUnitOfWork, settings: JobSettings) -> None:
    """Let the epochs hold the windows of their days."""
    epoch = select(func.min(EPOCHS.c.number)).where(
        EPOCHS.c.section == WINDOWS.c.track_section, EPOCHS.c.horizon_ns >= WINDOWS.c.start_ns
    )
    lookup = FileLookup(unit, settings, ClassLookup(unit, settings.estimation))
    columns = ("wheelset", "start_ns", "section", "epoch", "vehicle", "content_digest", "mileage_km", "context")
    names = [*columns, "assumed", "estimated_version"]
    copied = select(MOUNTINGS.c.wheelset, MOUNTINGS.c.vehicle).where(MOUNTINGS.c.vehicle.like("V-%"))
    for wheelset, vehicle in unit.connection.execute(copied).all():
        context = lookup.of(vehicle, wheelset).digest
        values = {"section": WINDOWS.c.track_section, "epoch": epoch.scalar_subquery(), "context": literal(context)}
        values |= {"assumed": literal("a" * 64), "estimated_version": literal(None)}
        chosen = [values.get(name, WINDOWS.c.get(name)) for name in names]
        rows = select(*chosen).where(WINDOWS.c.wheelset == wheelset)
        unit.connection.execute(insert(MEMBERS).from_select(names, rows))
