"""Stages: part what belongs to the rails of each section from what belongs to the wheels of each wheelset.

The first makes conicities of a wheelset by section, again in the mileage intervals that have changed; the second looks
at all of them together.
"""

from __future__ import annotations

import hashlib
import logging
from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from estimation.accuracy.fleet_accuracy import baseline_at
from estimation.accuracy.parameters import ACCURACY
from estimation.accuracy.wheel_contact import RailShare, WheelPair
from estimation.contact.profiles import MeasuredProfiles
from estimation.errors import DamagedError
from estimation.jobs.job import Job, JobContext
from estimation.jobs.parameters import JOBS
from estimation.jobs.runner import run_counted
from estimation.jobs.settings import RailsSettings
from estimation.jobs.stage import Counted, Outcome, Part, Stage
from estimation.jobs.steps.assumptions import last_break
from estimation.jobs.steps.rail_cells import CELL_VERSION, WheelsetCells, wheelset_cells
from estimation.rails.apart import exceeds, rails_apart, reported
from estimation.rails.cell import Anchors, ReferenceWheel, conicity_on_rails, designed_wheel, with_refused
from estimation.rails.parameters import RailsParameters
from estimation.storage import UnitOfWork
from estimation.values.arrays import FloatArray
from estimation.values.geometry import GEOMETRY
from estimation.values.opinions import (
    CELLS,
    SECTION_RAILS,
    WHEELSET_RAILS,
    KnownWheel,
    RailKey,
    RailPart,
    RailsApart,
    RailsFinding,
    StoredCell,
    WheelKey,
    WheelsFinding,
)
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.registry import WheelsetRecord
from estimation.values.runs import EVERYTHING, Facet, Result, SubjectKind
from estimation.values.track import TrackSectionRecord
from estimation.values.trend import TREND, on_one_side
from estimation.values.units import DAY_NS

OTHER_RAILS = Reason(
    ReasonCode.KNOWN_RAILS_OTHER, "named as known, with other rails, or another gauge, on file than the reference"
)
OTHER_TIME = Reason(
    ReasonCode.KNOWN_RAILS_OTHER_TIME, "named as known for another time than that of the newest windows there"
)


@dataclass(frozen=True, slots=True, order=True)
class MeasuredWheel:
    """A wheel with cells that was measured."""

    key: WheelKey
    at_ns: int
    digest: str  # of the profiles
    wheels: WheelPair = field(compare=False, repr=False, metadata={"made_from": False})


@dataclass(frozen=True, slots=True)
class AnchorInputs:
    """What anchors are made from; its text stands for it in a digest."""

    sections: tuple[TrackSectionRecord, ...]  # with cells
    known: frozenset[RailKey]  # rails that are as on file, those of the reference
    rails: RailShare | None  # the reference rails, at their gauge; None without a section
    profile: str  # of the wheel as designed
    nominal_radius: float  # m
    measured: tuple[MeasuredWheel, ...]
    other: Mapping[str, Reason] = field(default_factory=dict)  # why sections that are named as known hold no level
    missing: tuple[str, ...] = ()  # codes that are named as known, of which no section is on file

    @property
    def text(self) -> str:
        """All of it."""
        of_sections = [(section.code, RailShare.of(section), section.tonnage_mgt_per_year) for section in self.sections]
        named = (sorted(self.known), sorted((code, why.code) for code, why in self.other.items()), self.missing)
        rest = (named, self.rails, self.profile, self.nominal_radius, self.measured)
        return f"{of_sections!r} {rest!r}"


def anchor_inputs(unit: UnitOfWork, cells: Sequence[StoredCell], context: JobContext) -> AnchorInputs:
    """Return what holds the level of some cells, as it is on file.

    Sections with other rails, or another gauge, than those that all are compared with hold nothing, though their rails
    be known: what a wheel is there does not follow for the reference rails.
    """
    windows: Counter[str] = Counter()
    for cell in cells:
        windows[cell.rail.section] += 0 if cell.usable is None else cell.usable.windows
    on_file, codes = unit.tracks.sections(), {entry.code for entry in context.settings.rails.known_sections}
    sections = tuple(section for section in on_file if section.code in windows)
    named = {section.code: _at_gauge(unit, section) for section in sections if section.code in codes}
    rails = _most(named or {section.code: RailShare.of(section) for section in sections}, windows)
    alike = {code for code, its_rails in named.items() if rails is not None and _alike(its_rails, rails)}
    keys = sorted({cell.rail for cell in cells if cell.usable is not None and cell.rail.section in alike})
    as_on_file = frozenset(key for key in keys if _is_of_time(key, context.settings.rails))
    newest = {key.section: key for key in keys}
    other = dict.fromkeys(sorted(named.keys() - alike), OTHER_RAILS)
    other |= {code: OTHER_TIME for code, key in newest.items() if key not in as_on_file}
    serials = {cell.wheel.wheelset for cell in cells}
    wheelsets = [wheelset for wheelset in unit.registry.wheelsets() if wheelset.serial in serials]
    profiles = Counter((wheelset.wheel_profile, wheelset.nominal_radius_m) for wheelset in wheelsets)
    profile, radius = min(profiles, key=lambda profile: (-profiles[profile], profile), default=("", 0.0))
    missing = tuple(sorted(codes - {section.code for section in on_file}))
    measured = _measured_wheels(unit, wheelsets, cells, context.settings.estimation.interval_km)
    return AnchorInputs(sections, as_on_file, rails, profile, radius, measured, other, missing)


def anchors(inputs: AnchorInputs, amplitude: FloatArray) -> Anchors:
    """Return what holds the level, with the conicities that follow from profiles, at amplitudes (k,), m."""
    nothing = np.full(len(amplitude), np.nan)
    wheel = designed_wheel(inputs.profile, inputs.nominal_radius)
    if inputs.rails is None:
        return Anchors(ReferenceWheel(inputs.profile, nothing))
    rails = {section.code: RailShare.of(section) for section in inputs.sections}
    of_rails = {
        rail: nothing if wheel is None else conicity_on_rails(wheel, rail, amplitude)[0]
        for rail in {inputs.rails, *rails.values()}
    }
    on_file = {code: of_rails[its_rails] for code, its_rails in rails.items()}
    # the newest measurement of an interval counts
    newest = {wheel.key: wheel.wheels for wheel in sorted(inputs.measured, key=lambda wheel: wheel.at_ns)}
    return Anchors(
        ReferenceWheel(inputs.profile, of_rails[inputs.rails], on_file),
        inputs.known,
        tuple(KnownWheel(key, *conicity_on_rails(wheels, inputs.rails, amplitude)) for key, wheels in newest.items()),
        tonnage={s.code: s.tonnage_mgt_per_year for s in inputs.sections if s.tonnage_mgt_per_year},
        refused=inputs.other,
        missing=inputs.missing,
    )


def _measured_wheels(
    unit: UnitOfWork, wheelsets: Sequence[WheelsetRecord], cells: Sequence[StoredCell], interval_km: float
) -> tuple[MeasuredWheel, ...]:
    """Return the wheels with cells that were measured; what is damaged in the store is left out."""
    seen: dict[WheelKey, int] = {}
    for cell in cells:
        if cell.usable is not None:
            seen[cell.wheel] = min(cell.usable.from_ns, seen.get(cell.wheel, cell.usable.from_ns))
    wheels_measured = []
    of_profiles = unit.registry.measured_wheelsets()
    for wheelset in (wheelset for wheelset in wheelsets if wheelset.serial in of_profiles):
        try:
            measured = unit.registry.measured_profiles(wheelset.serial)
        except DamagedError:
            continue
        change = last_break(unit, wheelset)
        for profiles in measured:
            baseline, begin_km = baseline_at(wheelset, profiles.at_ns)
            key = WheelKey(wheelset.serial, baseline, int((profiles.mileage_km - begin_km) // interval_km))
            if key in seen and on_one_side(change, profiles.at_ns, seen[key]):
                wheels = WheelPair(profiles.left, profiles.right, wheelset.nominal_radius_m, profiles.std)
                wheels_measured.append(MeasuredWheel(key, profiles.at_ns, _profiles_digest(profiles), wheels))
    return tuple(sorted(wheels_measured))


def _profiles_digest(measured: MeasuredProfiles) -> str:
    """Return the digest of what was measured, for it may be corrected."""
    text = hashlib.sha256(repr((measured.mileage_km, measured.std)).encode())
    for profile in (measured.left, measured.right):
        for values in (profile.y, profile.z, profile.slope):
            text.update(values.tobytes())
    return text.hexdigest()


def _is_of_time(key: RailKey, settings: RailsSettings) -> bool:
    """Whether rails of a period are as on file: from that of the day for which this is known on, until they wear."""
    model = settings.model
    days = (entry.on_ns / DAY_NS for entry in settings.known_sections if entry.code == key.section)
    return any(day // model.period_days <= key.period <= (day + model.known_days) // model.period_days for day in days)


def _at_gauge(unit: UnitOfWork, section: TrackSectionRecord) -> RailShare:
    """Return the rails of a section at their mean gauge, as far as that is on file."""
    rails, track = RailShare.of(section), unit.tracks.alignment(section.code, None)
    if track is None or not track.gauge_known:
        return rails
    return replace(rails, gauge=round(rails.gauge + float(np.mean(track.gauge_deviation)), JOBS.gauge_digits))


def _alike(rails: RailShare, other: RailShare) -> bool:
    same = (rails.rail, rails.inclination) == (other.rail, other.inclination)
    return same and abs(rails.gauge - other.gauge) <= JOBS.gauge_tolerance


def _most(sections: Mapping[str, RailShare], windows: Counter[str]) -> RailShare | None:
    """Return the rails that most windows ran on, those alike counted together."""
    count = {
        rails: sum(windows[code] for code, its_rails in sections.items() if _alike(its_rails, rails))
        for rails in sections.values()
    }
    return min(count, key=lambda rails: (-count[rails], repr(rails)), default=None)


_log = logging.getLogger(__name__)


def make_cells(inputs: WheelsetCells) -> Outcome[StoredCell]:
    """Return the cells of a wheelset that are others by now."""
    return Outcome([Part(cell.made()) for cell in inputs.to_make])


def store_cells(
    unit: UnitOfWork, _: JobContext, made: Mapping[str, tuple[WheelsetCells, Outcome[StoredCell]]]
) -> Mapping[str, int]:
    """Store cells in place of what was of their keys; return how many are others, or gone."""
    changed = [part.value for _, outcome in made.values() for part in outcome.parts if part.value is not None]
    changed += [cell for inputs, _ in made.values() for cell in inputs.moved]
    gone = [key for inputs, _ in made.values() for key in inputs.gone]
    unit.rails.put_cells([*changed, *(cell for inputs, _ in made.values() for cell in inputs.kept)])
    unit.rails.drop_cells(gone)
    return {"cells": len(changed) + len(gone)}


@dataclass(frozen=True, slots=True)
class RailsInputs:
    """All cells, and what holds their level; the digest stands for both."""

    digest: str
    damaged: tuple[str, ...]  # wheelsets with cells that cannot be read
    cells: tuple[StoredCell, ...] = field(metadata={"made_from": False})
    on_file: AnchorInputs = field(metadata={"made_from": False})
    amplitude: FloatArray = field(metadata={"made_from": False})  # (k,) m
    parameters: RailsParameters = field(metadata={"made_from": False})


@dataclass(frozen=True, slots=True)
class RailsFindings:
    """What was found of all sections, and of all wheelsets in their newest interval."""

    sections: Mapping[str, RailsFinding]
    wheelsets: Mapping[str, WheelsFinding]
    # why sections that are named as known, by code, and wheelsets that are measured hold no level
    refused: Mapping[str, str]
    refused_wheels: Mapping[str, str]


def load_rails(unit: UnitOfWork, _: Sequence[str], context: JobContext) -> Mapping[str, RailsInputs]:
    """Return what parting wheels and rails is made from."""
    parameters, cells = context.settings.rails.model, unit.rails.cells()
    on_file = anchor_inputs(unit, cells, context)
    stand_for = [(cell.wheel, cell.rail, cell.digest, cell.reason and str(cell.reason.code)) for cell in cells]
    text = f"{stand_for!r} {on_file.text} {parameters!r}"
    usable = next((cell.usable for cell in cells if cell.usable is not None), None)
    curve = context.settings.estimation.geometry.curve
    inputs = RailsInputs(
        digest=hashlib.sha256(text.encode()).hexdigest(),
        damaged=tuple(sorted({cell.wheel.wheelset for cell in cells if cell.damaged})),
        cells=tuple(cells),
        on_file=on_file,
        amplitude=np.array(curve.amplitudes) if usable is None else usable.amplitude,
        parameters=parameters,
    )
    return {EVERYTHING: inputs}


def part_rails(inputs: RailsInputs) -> Outcome[RailsFindings]:
    """Return what belongs to rails, and what belongs to wheels."""
    usable = [cell.usable for cell in inputs.cells if cell.usable is not None]
    held = anchors(inputs.on_file, inputs.amplitude)
    apart = rails_apart(usable, inputs.amplitude, held, inputs.parameters)
    apart = with_refused(apart, inputs.cells)
    newest = {wheel.wheel.wheelset: wheel for wheel in apart.wheels}  # in the order of their keys
    amplitude, refused_wheels = tuple(apart.amplitude.tolist()), apart.refused_wheels
    findings = RailsFindings(
        sections=_sections(apart, held.wheel.profile, inputs.parameters),
        wheelsets={serial: WheelsFinding(amplitude, w, refused_wheels.get(serial)) for serial, w in newest.items()},
        refused=dict.fromkeys(held.missing, "not on file") | {code: str(why) for code, why in apart.refused.items()},
        refused_wheels={serial: str(why) for serial, why in refused_wheels.items()},
    )
    return Outcome([Part(findings)])


def _sections(apart: RailsApart, profile: str, parameters: RailsParameters) -> Mapping[str, RailsFinding]:
    """Return what is found of every section, its periods oldest first."""
    periods: defaultdict[str, list[RailPart]] = defaultdict(list)
    for rail in apart.rails:
        periods[rail.rail.section].append(rail)
    findings = {}
    for section, parts in sorted(periods.items()):
        newest = reported(parts[-1].excess, apart.amplitude, parameters)
        excess, amplitude = (None, None) if newest is None else newest
        findings[section] = RailsFinding(
            amplitude=tuple(apart.amplitude.tolist()),
            reference_wheel_profile=profile,
            periods=tuple(parts),
            trend=apart.trends.get(section),
            limit=parameters.limit,
            exceeded=None if excess is None else exceeds(excess, parameters.limit),
            reported_amplitude=amplitude,
            refused=apart.refused.get(section),
            no_trend=apart.no_trends.get(section),
        )
    return findings


def store_rails(
    unit: UnitOfWork, context: JobContext, made: Mapping[str, tuple[RailsInputs, Outcome[RailsFindings]]]
) -> Mapping[str, int]:
    """Store what was found in the place of all that was found before; cells that cannot be read are made again."""
    inputs, outcome = made[EVERYTHING]
    (part,) = outcome.parts
    assert part.value is not None
    for kind, findings in ((SECTION_RAILS, part.value.sections), (WHEELSET_RAILS, part.value.wheelsets)):
        common = (inputs.digest, context.code_version, context.clock.now_ns())
        unit.results.replace_all(kind, [Result(subject, *common, finding) for subject, finding in findings.items()])
    if inputs.damaged:
        unit.marks.forget(CELLS, inputs.damaged)
    for code, why in sorted(part.value.refused.items()):
        _log.warning("section %s is named as known, but holds no level: %s", code, why)
    for serial, why in sorted(part.value.refused_wheels.items()):
        _log.warning("wheelset %s is measured, but holds no level: %s", serial, why)
    return {"sections": len(part.value.sections), "known_refused": len(part.value.refused)}


OF_WHEELSETS = Stage(
    name=CELLS,
    job="refresh_rails",
    kind=SubjectKind.WHEELSET,
    facets=(Facet.REGISTRY, Facet.RESTARTS, GEOMETRY.stage, TREND.head_facet),
    settings=lambda settings: (CELL_VERSION, settings.estimation, settings.rails.model.period_days),
    load=wheelset_cells,
    compute=make_cells,
    counted=Counted(looked="wheelsets", changed="cells"),
    store=store_cells,
    at_once=4,
)
OF_ALL = Stage(
    name="rails",
    job=OF_WHEELSETS.job,
    kind=SubjectKind.WHEELSET,
    facets=(Facet.REGISTRY, Facet.RESTARTS, Facet.ALIGNMENT, TREND.head_facet, CELLS),
    settings=lambda settings: (settings.rails, settings.estimation),
    load=load_rails,
    compute=part_rails,
    counted=Counted(looked="looks", changed="sections", more=("known_refused",)),
    numbers=(ACCURACY,),
    store=store_rails,
    together=True,
)


JOB = Job(
    name=OF_WHEELSETS.job,
    description="Part what belongs to the rails of sections from what belongs to the wheels of wheelsets",
    every_s=3_600.0,
    run=partial(run_counted, (OF_WHEELSETS, OF_ALL)),
)
