"""What holds the level of wheels and rails: sections whose rails are as on file, and wheelsets that were measured."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from estimation.accuracy.estimate_of_date import baseline_at
from estimation.accuracy.wheel_contact import RailShare, WheelPair
from estimation.errors import DamagedError
from estimation.jobs.job import JobContext
from estimation.rails.design import conicity_on_rails, designed_wheel
from estimation.rails.parameters import Anchors, ReferenceWheel
from estimation.storage import UnitOfWork
from estimation.values.arrays import FloatArray
from estimation.values.rails import KnownWheel, StoredCell, WheelKey
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.registry import WheelsetRecord
from estimation.values.track import TrackSectionRecord

OTHER_RAILS = Reason(ReasonCode.KNOWN_RAILS_OTHER, "named as known, with other rails on file than the reference")


@dataclass(frozen=True, slots=True)
class AnchorInputs:
    """What anchors are made from; its text stands for it in a digest."""

    sections: tuple[TrackSectionRecord, ...]  # with cells
    known: frozenset[str]  # sections whose rails are as on file, those of the reference rails
    rails: RailShare | None  # the reference rails; None without a section
    profile: str  # of the wheel as designed
    nominal_radius: float  # m
    measured: tuple[tuple[WheelKey, int], ...]  # wheels with cells that were measured, and when
    other: frozenset[str] = frozenset()  # sections that are named as known, with other rails than those
    missing: tuple[str, ...] = ()  # codes that are named as known, of which no section is on file

    @property
    def text(self) -> str:
        """All of it."""
        of_sections = [(one.code, _rails_of(one), one.tonnage_mgt_per_year) for one in self.sections]
        named = (sorted(self.known), sorted(self.other), self.missing)
        rest = (named, self.rails, self.profile, self.nominal_radius, self.measured)
        return f"{of_sections!r} {rest!r}"


def anchor_inputs(unit: UnitOfWork, cells: Sequence[StoredCell], context: JobContext) -> AnchorInputs:
    """Return what holds the level of some cells, as it is on file.

    Sections with other rails than those that all are compared with hold nothing, though their rails be known: what a
    wheel is there does not follow for the reference rails.

    Parameters
    ----------
    unit
        Registry and sections are read.
    cells
        All.
    context
        Names the sections whose rails are as on file.
    """
    windows: Counter[str] = Counter()
    for one in cells:
        windows[one.rail.section] += 0 if one.cell is None else one.cell.windows
    on_file = unit.tracks.sections()
    sections = tuple(one for one in on_file if one.code in windows)
    named = [one for one in sections if one.code in context.settings.rails.known_sections]
    missing = context.settings.rails.known_sections - {one.code for one in on_file}
    rails = _most(named or sections, windows)
    serials = {one.wheel.wheelset for one in cells}
    wheelsets = [one for one in unit.registry.wheelsets() if one.serial in serials]
    profiles = Counter((one.wheel_profile, one.nominal_radius_m) for one in wheelsets)
    profile, radius = min(profiles, key=lambda one: (-profiles[one], one), default=("", 0.0))
    wheels = {one.wheel for one in cells if one.cell is not None}
    interval_km = context.settings.estimation.interval_km
    measured = (
        (key, at_ns) for wheelset in wheelsets for key, at_ns in _measured(unit, wheelset, interval_km) if key in wheels
    )
    known = frozenset(one.code for one in named if _rails_of(one) == rails)
    other = frozenset(one.code for one in named) - known
    measured_wheels = tuple(sorted(measured))
    return AnchorInputs(sections, known, rails, profile, radius, measured_wheels, other, tuple(sorted(missing)))


def anchors(unit: UnitOfWork, inputs: AnchorInputs, amplitude: FloatArray) -> Anchors:
    """Return what holds the level, with the conicities that follow from profiles.

    Parameters
    ----------
    unit
        Measured profiles are read.
    inputs
        From :func:`anchor_inputs`.
    amplitude
        (k,) m.
    """
    nothing = np.full(len(amplitude), np.nan)
    wheel = designed_wheel(inputs.profile, inputs.nominal_radius)
    if inputs.rails is None:
        return Anchors(ReferenceWheel(inputs.profile, nothing))
    on_file: dict[str, FloatArray] = {}
    of_rails: dict[RailShare, FloatArray] = {}
    for section in inputs.sections if wheel is not None else ():
        assert wheel is not None
        rails = _rails_of(section)
        if rails not in of_rails:
            of_rails[rails] = conicity_on_rails(wheel, rails, amplitude)[0]
        on_file[section.code] = of_rails[rails]
    reference = ReferenceWheel(inputs.profile, of_rails.get(inputs.rails, nothing), on_file)
    return Anchors(
        reference,
        inputs.known,
        tuple(_known_wheels(unit, inputs, inputs.rails, amplitude)),
        tonnage={one.code: one.tonnage_mgt_per_year for one in inputs.sections if one.tonnage_mgt_per_year},
        refused=dict.fromkeys(inputs.other, OTHER_RAILS),
        missing=inputs.missing,
    )


def _known_wheels(unit: UnitOfWork, inputs: AnchorInputs, rails: RailShare, amplitude: FloatArray) -> list[KnownWheel]:
    """Return the conicity of measured wheels on the reference rails; the newest measurement of an interval counts."""
    found = {}
    for key, at_ns in sorted(inputs.measured, key=lambda one: one[1]):
        wheelset = unit.registry.wheelset(key.wheelset)
        for one in unit.registry.measured_profiles(key.wheelset):
            if one.at_ns == at_ns:
                wheels = WheelPair(one.left, one.right, wheelset.nominal_radius_m, one.std)
                found[key] = KnownWheel(key, *conicity_on_rails(wheels, rails, amplitude))
    return list(found.values())


def _measured(unit: UnitOfWork, wheelset: WheelsetRecord, interval_km: float) -> list[tuple[WheelKey, int]]:
    """Return the mileage intervals in which a wheelset was measured; what is damaged in the store is left out."""
    try:
        measured = unit.registry.measured_profiles(wheelset.serial)
    except DamagedError:
        return []
    found = []
    for one in measured:
        baseline, begin_km = baseline_at(wheelset, one.at_ns)
        interval = int((one.mileage_km - begin_km) // interval_km)
        found.append((WheelKey(wheelset.serial, baseline, interval), one.at_ns))
    return found


def _rails_of(section: TrackSectionRecord) -> RailShare:
    return RailShare(section.rail_profile, section.rail_inclination, section.nominal_gauge_m, 1.0)


def _most(sections: Sequence[TrackSectionRecord], windows: Counter[str]) -> RailShare | None:
    """Return the rails that most windows ran on."""
    count: Counter[RailShare] = Counter()
    for one in sections:
        count[_rails_of(one)] += windows[one.code]
    return min(count, key=lambda rails: (-count[rails], repr(rails)), default=None)
