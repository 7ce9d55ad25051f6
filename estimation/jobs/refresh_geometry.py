"""Job: bin tables of a wheelset become its geometry, per mileage interval and current.

The estimator of the settings decides how: ``bins`` merges the stored bin tables, any other works on the motion of the
same windows.
"""

from __future__ import annotations

import hashlib
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace

from estimation.estimators.catalogue import SHIPPED, estimator_named
from estimation.estimators.interface import EstimatorParameters
from estimation.estimators.wheelset_geometry import PublishedBins, geometry_from_motion
from estimation.geometry.estimate import estimate_geometry
from estimation.geometry.uncertainty import ParameterUncertainty
from estimation.jobs.isolation import Isolation, inputs_of
from estimation.jobs.job import Job, JobContext
from estimation.jobs.settings import EstimationSettings
from estimation.jobs.steps.baselines import Baseline, baselines
from estimation.jobs.steps.contradicted_windows import CONTRADICTIONS, contradiction
from estimation.jobs.steps.identities import identity_change
from estimation.jobs.steps.replay import TabulatedWindow, replayed
from estimation.jobs.steps.rolling_radius import radius_contradicted
from estimation.jobs.steps.running_mileage import mean_mileage, running_mileage
from estimation.jobs.steps.vehicle_classes import Assumed, ClassLookup
from estimation.motion.parameters import WindowParameters
from estimation.storage import UnitOfWork
from estimation.tables import bin_table
from estimation.tables.bin_table import BinParameters, bin_parameters
from estimation.values.geometry import LEFT_OUT, FilledCells, GeometryRecord, WheelsetGeometry
from estimation.values.identity import IdentityChange
from estimation.values.json_value import JsonValue
from estimation.values.motion import Motion
from estimation.values.quantities import Status
from estimation.values.quarantine import SubjectKind
from estimation.values.reasons import Reason
from estimation.values.registry import Mounting
from estimation.values.windows import WindowRecord
from estimation.vehicle.equations_of_motion import VehicleParameters

_STALE_AT_ONCE = 10_000
REMEMBERED_HALF_LIVES = 20.0  # a weight of one in a million


def run(context: JobContext) -> Mapping[str, int]:
    """Refresh every wheelset whose windows changed; each wheelset is committed together."""
    counts: Counter[str] = Counter(wheelsets=0, geometries=0)
    isolation = Isolation(context, "refresh_geometry")
    with context.storage.read() as unit:
        named = context.settings.estimation.estimator
        stale = unit.geometries.stale(_STALE_AT_ONCE, "" if named == SHIPPED else named)
    for done, serial in enumerate(stale, start=1):
        inputs = inputs_of(context, serial)
        if not isolation.waits(SubjectKind.WHEELSET, serial, inputs):
            with isolation.alone(SubjectKind.WHEELSET, serial, inputs):
                counts["geometries"] += _refresh(context, serial)
                counts["wheelsets"] += 1
        context.checkpoint(done, len(stale))
    counts["quarantined"] = isolation.quarantined
    return counts


def _refresh(context: JobContext, serial: str) -> int:
    with context.storage.read() as unit:
        change = unit.geometries.change(serial)
        records = refreshed(unit, serial, context)
    with context.storage.write() as unit:
        changed = sum(unit.geometries.put(record) for record in records)
        unit.geometries.mark_current(serial, change)
    return changed


JOB = Job("refresh_geometry", "Merge bin tables into wheelset geometries", every_s=300.0, run=run)

_Entry = tuple[WindowRecord, str, int | None]  # window, parameter key, track version


def refreshed(unit: UnitOfWork, serial: str, context: JobContext) -> list[GeometryRecord]:
    """Return the geometries of one wheelset whose inputs differ from what is stored; the current one comes last.

    Only the tables that such a geometry needs are read, so that new windows cost themselves and not the history. A
    geometry whose windows are all gone (refused since, or of another baseline now) is followed by an empty one. The
    current geometry is that of the newest baseline with windows. What was measured before and
    after an identity change of the wheelset is never merged, and what cannot be assigned to either side is left out.
    Nor is what was measured on vehicles of different classes: the current geometry is of the class that the wheelset
    ran in last, an interval of the one with most of its windows.

    Parameters
    ----------
    unit
        Tables, geometries, alerts and the registry are read.
    serial
        Serial number of the wheelset.
    context
        Settings of the estimation and version of the numerics.
    """
    settings = context.settings.estimation
    records: list[GeometryRecord] = []
    newest: tuple[Baseline, list[_Entry]] | None = None
    change = identity_change(unit, serial)
    refused = unit.windows.refused(serial, CONTRADICTIONS)
    classes = ClassLookup(unit, settings)
    turned = [mounting for mounting in unit.registry.mountings(serial) if mounting.reversed]
    for baseline in baselines(unit.registry.wheelset(serial)):
        index = _running(unit.tables.index(serial, baseline.from_ns, baseline.to_ns))
        digests = unit.tables.digests(serial, baseline.from_ns, baseline.to_ns)
        entries = _apart(
            [
                _marked(entry, turned, digests)
                for entry in index
                if entry[1] == classes.table_key(entry[0].vehicle, serial)
            ],
            change,
        )
        records += _intervals(unit, serial, baseline, entries, context, classes, refused)
        if entries:
            newest = baseline, entries
    records += _ended(unit, serial, None if newest is None else newest[0].number, context)
    if newest is not None:
        near = _remembered(_since(newest[1], change), settings.half_life_km)
        assumed = _assumed(near[-1], classes)
        used = _of_class(near, assumed, classes)
        against = contradiction(refused, [entry[0] for entry in used])
        record = _record(unit, newest[0], None, used, context, assumed, against)
        left_out = unit.plausibility.left_out(serial, newest[0].from_ns)
        counted: dict[str, JsonValue] = {code.value: count for code, count in left_out.items()}
        records.append(replace(record, parameters={**record.parameters, LEFT_OUT: counted}))
    return records


def _ended(unit: UnitOfWork, serial: str, newest: int | None, context: JobContext) -> list[GeometryRecord]:
    """Return empty geometries behind those of baselines that have no windows any more, or that there are not.

    A reprofiling that was voided leaves fewer baselines than have been estimated.
    """
    number = len(baselines(unit.registry.wheelset(serial)))
    left = [
        record
        for record in unit.geometries.baselines(serial)
        if record.geometry.windows and (newest is None or record.baseline > newest)
    ]
    left += [r for r in unit.geometries.intervals(serial) if r.baseline >= number and r.geometry.windows]
    return [_emptied(record, context) for record in left]


def _intervals(
    unit: UnitOfWork,
    serial: str,
    baseline: Baseline,
    entries: Sequence[_Entry],
    context: JobContext,
    classes: ClassLookup,
    refused: Sequence[WindowRecord],
) -> list[GeometryRecord]:
    """Return the geometries per mileage interval of one baseline that are not stored like that."""
    settings = context.settings.estimation
    stored = {r.interval: r for r in unit.geometries.intervals(serial, baseline.number)}
    parts = _by_interval(entries, baseline, settings.interval_km)
    records = []
    for interval, part in parts.items():
        assumed = _most_frequent(part, classes)
        used = _of_class(part, assumed, classes)
        against = contradiction(refused, [entry[0] for entry in used])
        if interval not in stored or stored[interval].input_digest != _digest(used, context, assumed, against):
            records.append(_record(unit, baseline, interval, used, context, assumed, against))
    return records + [_emptied(record, context) for interval, record in stored.items() if interval not in parts]


def _running(entries: Sequence[_Entry]) -> list[_Entry]:
    """Return the entries with the mileage that their wheelset had run, whatever its odometer did."""
    mileages = running_mileage([entry[0] for entry in entries])
    return [
        (replace(window, mileage_km=mileage_km), key, version)
        for (window, key, version), mileage_km in zip(entries, mileages, strict=True)
    ]


def _assumed(entry: _Entry, classes: ClassLookup) -> Assumed:
    """Return what the table of an entry was made with; entries of unknown classes have been left out."""
    found = classes.assumed(entry[0].vehicle, entry[0].wheelset)
    assert isinstance(found, Assumed)
    return found


def _most_frequent(entries: Sequence[_Entry], classes: ClassLookup) -> Assumed:
    """Return what most of the entries were made with; of several the newest."""
    count = Counter(_assumed(entry, classes).digest for entry in entries)
    return max((_assumed(entry, classes) for entry in reversed(entries)), key=lambda one: count[one.digest])


def _of_class(entries: Sequence[_Entry], assumed: Assumed, classes: ClassLookup) -> list[_Entry]:
    """Return the entries that were made with certain parameters of one class."""
    return [entry for entry in entries if _assumed(entry, classes).digest == assumed.digest]


def _marked(entry: _Entry, turned: Sequence[Mounting], digests: Mapping[int, str]) -> _Entry:
    """Return the entry with its key saying which table it is, and whether the wheelset was the other way round."""
    at_ns = entry[0].start_ns
    key = " ".join((entry[1], *([digests[at_ns]] if at_ns in digests else ())))
    if any(m.from_ns <= at_ns and (m.to_ns is None or at_ns < m.to_ns) for m in turned):
        key = f"{key} reversed"
    return entry[0], key, entry[2]


def _apart(entries: Sequence[_Entry], change: IdentityChange | None) -> list[_Entry]:
    """Return the entries before or after an identity change."""
    if change is None:
        return list(entries)
    return [e for e in entries if e[0].start_ns < change.before_ns or e[0].start_ns >= change.after_ns]


def _since(entries: Sequence[_Entry], change: IdentityChange | None) -> Sequence[_Entry]:
    """Return the entries after an identity change; all where there are none."""
    after = [entry for entry in entries if change is not None and entry[0].start_ns >= change.after_ns]
    return after or entries


def _emptied(record: GeometryRecord, context: JobContext) -> GeometryRecord:
    """Return what follows ``record`` when none of its windows is left."""
    settings = context.settings.estimation
    return replace(
        record,
        geometry=_nothing(settings, record.geometry.parameter_key),
        input_digest=_digest([], context, None),
        track_versions={},
        parameters=settings.as_json(),
        code_version=context.code_version,
        recorded_ns=context.clock.now_ns(),
    )


def _by_interval(entries: Sequence[_Entry], baseline: Baseline, interval_km: float) -> dict[int, list[_Entry]]:
    parts: defaultdict[int, list[_Entry]] = defaultdict(list)
    for entry in entries:
        parts[int((entry[0].mileage_km - baseline.mileage_km) // interval_km)].append(entry)
    return parts


def _remembered(entries: Sequence[_Entry], half_life_km: float) -> list[_Entry]:
    """Return the entries that forgetting has left a weight worth keeping."""
    newest = entries[-1][0].mileage_km
    return [entry for entry in entries if newest - entry[0].mileage_km <= REMEMBERED_HALF_LIVES * half_life_km]


def _tables(unit: UnitOfWork, entries: Sequence[_Entry]) -> Iterator[tuple[float, FilledCells]]:
    """Yield mileage and table of the entries, oldest first."""
    wanted = {entry[0].start_ns: entry[0].mileage_km for entry in entries}
    first, last = entries[0][0], entries[-1][0]
    for start_ns, table in unit.tables.filled(first.wheelset, first.start_ns, last.start_ns + 1):
        if start_ns in wanted:
            yield wanted[start_ns], table


def _digest(
    entries: Sequence[_Entry], context: JobContext, assumed: Assumed | None, against: Reason | None = None
) -> str:
    of_class = "" if assumed is None else f" {assumed.digest}"
    of_class += "" if against is None else f" {against.code}"
    text = hashlib.sha256(f"{context.code_version} {context.settings.estimation.estimator}{of_class}\n".encode())
    for window, key, version in entries:
        text.update(f"{window.start_ns} {window.content_digest} {key} {version} {window.mileage_km!r}\n".encode())
    return text.hexdigest()


def _versions(entries: Sequence[_Entry]) -> dict[str, tuple[int, ...]]:
    """Return by section the versions of its alignment that the tables of the entries rest on, increasing."""
    found: defaultdict[str, set[int]] = defaultdict(set)
    for window, _, version in entries:
        if window.track_section is not None and version is not None:
            found[window.track_section].add(version)
    return {section: tuple(sorted(versions)) for section, versions in found.items()}


def _record(
    unit: UnitOfWork,
    baseline: Baseline,
    interval: int | None,
    entries: Sequence[_Entry],
    context: JobContext,
    assumed: Assumed,
    against: Reason | None,
) -> GeometryRecord:
    settings = context.settings.estimation
    windows = [entry[0] for entry in entries]
    versions = _versions(entries)
    newest = [unit.tracks.alignment(code, used[-1]) for code, used in versions.items()]
    tracks = [track for track in newest if track is not None]
    of_class = ParameterUncertainty.of(assumed.on_file.vehicle_class)
    used = _Used(settings, assumed, of_class.on(tracks, windows[0].wheelset))
    half_life_km = settings.half_life_km if interval is None else None
    geometry = _geometry(unit, entries, used, half_life_km)
    if geometry.status is not Status.MODEL_MISMATCH:
        contradicted = against or radius_contradicted(unit, windows, assumed.windows)
        geometry = geometry if contradicted is None else geometry.mismatched(contradicted)
    return GeometryRecord(
        wheelset=windows[0].wheelset,
        baseline=baseline.number,
        interval=interval,
        mileage_km=mean_mileage(windows, half_life_km),
        from_ns=windows[0].start_ns,
        to_ns=windows[-1].start_ns + windows[-1].length_ns,
        geometry=geometry,
        input_digest=_digest(entries, context, assumed, against),
        track_versions=versions,
        parameters=used.as_json(),
        code_version=context.code_version,
        recorded_ns=context.clock.now_ns(),
    )


@dataclass(frozen=True, slots=True)
class _Used:
    """What a geometry is estimated with."""

    settings: EstimationSettings
    assumed: Assumed
    uncertainty: ParameterUncertainty

    def as_json(self) -> Mapping[str, JsonValue]:
        """Return all of it, for the provenance: the class by code, version and digest, the radius, the settings."""
        on_file, geometry = self.assumed.on_file, replace(self.settings.geometry, uncertainty=self.uncertainty)
        of_class: dict[str, JsonValue] = {
            "code": on_file.vehicle_class.code,
            "version": on_file.version,
            "digest": on_file.digest,
        }
        return {
            **replace(self.settings, geometry=geometry).as_json(),
            "vehicle_class": of_class,
            "vehicle": asdict(self.assumed.windows.vehicle),
        }


def _geometry(unit: UnitOfWork, entries: Sequence[_Entry], used: _Used, half_life_km: float | None) -> WheelsetGeometry:
    """Return the geometry of the entries' windows; ``half_life_km`` is of forgetting, None for none."""
    bins, settings = bin_parameters(used.assumed.windows), used.settings
    tables = _tables(unit, entries)
    table = (
        bin_table.merge_all((table for _, table in tables), bins)
        if half_life_km is None
        else bin_table.merge_with_mileage(tables, half_life_km, bins)
    )
    shipped = estimate_geometry(table, bins, replace(settings.geometry, uncertainty=used.uncertainty))
    if settings.estimator == SHIPPED:
        return shipped
    motions = _weighted_motions(unit, entries, used.assumed.windows, half_life_km)
    published = PublishedBins(bins.edges, settings.geometry_key(bins.key))
    other = _from_motions(motions, settings, used.assumed.windows.vehicle, used.uncertainty, published)
    if shipped.status is Status.MODEL_MISMATCH and shipped.reason is not None:
        return other.mismatched(shipped.reason)  # whatever the estimator, the data do not follow the class
    return other


def _nothing(settings: EstimationSettings, parameter_key: str) -> WheelsetGeometry:
    """Return the geometry of no window, under the key of what it follows."""
    bins = BinParameters(source=settings.signals.source, band_limited=True)
    table_key = parameter_key.partition(" ")[0]
    if settings.estimator != SHIPPED:
        published = PublishedBins(bins.edges, settings.geometry_key(table_key))
        return _from_motions((), settings, bins.vehicle, settings.geometry.uncertainty, published)
    empty = estimate_geometry(bin_table.init(bins), bins, settings.geometry)
    return replace(empty, parameter_key=table_key)


def _from_motions(
    motions: Iterable[tuple[float, Motion]],
    settings: EstimationSettings,
    vehicle: VehicleParameters,
    uncertainty: ParameterUncertainty,
    published: PublishedBins,
) -> WheelsetGeometry:
    """Return the geometry that the estimator of the settings finds in motions, each with its weight."""
    parameters = EstimatorParameters(
        vehicle, uncertainty, settings.geometry.curve, settings.signals.source, band_limited=True
    )
    return geometry_from_motion(estimator_named(settings.estimator), parameters, motions, published)


def _weighted_motions(
    unit: UnitOfWork, entries: Sequence[_Entry], parameters: WindowParameters, half_life_km: float | None
) -> Iterator[tuple[float, Motion]]:
    """Yield weight and motion of the entries' windows, oldest first; the newest has weight 1."""
    newest = entries[-1][0].mileage_km
    windows = [TabulatedWindow(record, version) for record, _, version in entries]
    for record, moved in replayed(unit, windows, parameters):
        yield 1.0 if half_life_km is None else 0.5 ** ((newest - record.mileage_km) / half_life_km), moved
