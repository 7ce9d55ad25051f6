"""Track sections, versions of their alignment, and what else the passes of a section show."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Annotated

import numpy as np
from annotated_types import Interval

from estimation.values.arrays import FloatArray, FrozenArrays, IntArray, freeze
from estimation.values.fields import MM, FileForm, JsonValue, Key, Served
from estimation.values.quantities import Status
from estimation.values.reasons import Reason
from estimation.values.units import IN_MM
from estimation.values.windows import WindowRecord

MOST_TONNAGE_MGT = 1000.0  # a year, on one section


@dataclass(frozen=True, slots=True)
class OpenScale:
    """Std of the scale of an alignment from which on an unknown gauge may hide in it, and from which on it does."""

    low: float = 0.05
    high: float = 0.08


OPEN_SCALE = OpenScale()


def open_gauge_std(scale_std: float, gauge_std: float) -> float:
    """Return the std, m, of an unknown gauge that moves all wheelsets together.

    What makes passes disagree is stated as gauge (``gauge_std``, m), and need not be one. A gauge of waves so long that
    passes do not show it leaves the scale of the alignment open.
    """
    return min(max((scale_std - OPEN_SCALE.low) / (OPEN_SCALE.high - OPEN_SCALE.low), 0.0), 1.0) * gauge_std


class AlignmentSource(StrEnum):
    """Where an alignment comes from."""

    RECORDED = "recorded"  # a survey, as registered
    FLEET = "fleet"  # estimated from passes


@dataclass(frozen=True, slots=True)
class GaugeShift(FrozenArrays):
    """Where a gauge deviation puts a wheelset: y - d at a rolling radius difference and a gauge deviation, m.

    The shift is against nominal gauge at the same rolling radius difference: that is measured well, and contact
    jumps, which move over y - d with the gauge, are steps of it. Linear between the grids, flat beyond them.
    """

    difference: Annotated[FloatArray, "n"]  # rL - rR, m, uniform, increasing
    gauge: Annotated[FloatArray, "m"]  # m, uniform, increasing
    shift: Annotated[FloatArray, "n", "m"]  # m

    def at(self, difference: FloatArray, gauge_deviation: FloatArray) -> FloatArray:
        """Return the shift (n,), m, at rL - rR (n,) and gauge deviation (n,), m."""
        i, u = _cells(difference, self.difference)
        j, v = _cells(gauge_deviation, self.gauge)
        table = self.shift
        low = (1.0 - v) * table[i, j] + v * table[i, j + 1]
        high = (1.0 - v) * table[i + 1, j] + v * table[i + 1, j + 1]
        return np.asarray((1.0 - u) * low + u * high)

    def over(self, difference: FloatArray, gauge_deviation: FloatArray) -> FloatArray:
        """Return the shift (n, g), m, at every rL - rR (n,) for each of some gauge deviations (g,), m."""
        i, u = _cells(difference, self.difference)
        j, v = _cells(gauge_deviation, self.gauge)
        table = (1.0 - v) * self.shift[:, j] + v * self.shift[:, j + 1]
        return np.asarray((1.0 - u)[:, None] * table[i] + u[:, None] * table[i + 1])


def _cells(values: FloatArray, grid: FloatArray) -> tuple[IntArray, FloatArray]:
    """Return the cell (n,) of a uniform grid that holds each value, and where in it, 0 to 1."""
    position = np.clip((values - grid[0]) / (grid[1] - grid[0]), 0.0, len(grid) - 1.0)
    cell = np.minimum(position.astype(np.int64), len(grid) - 2)
    return cell, np.asarray(position - cell)


@dataclass(frozen=True, slots=True)
class TrackFindings:
    """What the passes of a section show besides its alignment: of vehicles and wheelsets that passed it."""

    stiffness_ratio: Mapping[str, float]  # by vehicle: true yaw stiffness over creep coefficient, of the assumed one
    stiffness_ratio_std: float  # largest of them
    gauge_shifts: Mapping[str, GaugeShift]  # by wheelset, where gauge varies


@dataclass(frozen=True, slots=True, eq=False)
class TrackAlignment(FrozenArrays):
    """Lateral alignment and gauge deviation of a section with their std; a key of caches: equal if the same object."""

    section: str
    version: int
    s: Annotated[FloatArray, "n"]  # m, uniform
    alignment: Annotated[FloatArray, "n"]  # m, positive to the left
    alignment_std: Annotated[FloatArray, "n"]  # m
    gauge_deviation: Annotated[FloatArray, "n"]  # m, actual minus nominal gauge
    gauge_deviation_std: Annotated[FloatArray, "n"]  # m
    passes: Annotated[IntArray, "n"]  # passes behind each value; 0 for a recording car
    status: Status
    source: AlignmentSource = AlignmentSource.RECORDED
    cutoff_wavelength: float = np.inf  # m; longer wavelengths are not in ``alignment``
    scale_std: float = 0.0  # relative, of a common scale error of y - d that the alignment leaves open
    gauge_known: bool = True  # False: from the passes alone, or zero for want of knowledge; see its std
    findings: TrackFindings | None = None  # of a fleet, on its own alignment or on a recording whose gauge varies

    @property
    def band_limited(self) -> bool:
        """Whether the alignment has been high-passed: whoever compares it must not filter it again."""
        return bool(np.isfinite(self.cutoff_wavelength))


@dataclass(frozen=True, slots=True)
class TrackLayout:
    """The horizontal layout of a track section as built, from the infrastructure register; straight between points."""

    section: str
    version: int
    s: Annotated[FloatArray, "n"]  # m along the section, strictly increasing
    curvature: Annotated[FloatArray, "n"]  # 1/m, positive in a curve to the left
    cant: Annotated[FloatArray, "n"]  # m, right rail above left: positive leaning into a curve to the left

    def __post_init__(self) -> None:
        freeze(self)
        if len(self.s) <= 1 or not (np.diff(self.s) > 0).all():
            raise ValueError("s: two points or more, strictly increasing, are needed")


SectionLine = tuple[tuple[float, float, float], ...]
"""Points of a section: distance along it, m, increasing; latitude and longitude, deg, WGS84."""


@dataclass(frozen=True, slots=True)
class TrackSectionRecord:
    """A section of line by code; ``number`` is what the vehicle reports on its bus.

    ``line`` is where it is on the map; None where that is not known, and nothing can be compared with it.
    ``tonnage_mgt_per_year`` is the traffic that wears its rails, million gross tonnes a year; None where not known.
    """

    code: Annotated[str, FileForm.CODE, Served(example="main-1")]
    number: Annotated[int, Interval(ge=1, le=65534), Served("Number of the section on the vehicle's bus.")]
    name: Annotated[str, FileForm.TEXT]
    rail_profile: Annotated[str, FileForm.TEXT, Served(example="56E1")]
    rail_inclination: Annotated[float, Interval(ge=0.0, le=0.5), Served(name="rail_inclination_1", example=0.05)]
    nominal_gauge_m: Annotated[
        float,
        Interval(ge=500.0, le=2000.0),
        MM,
        Key("nominal_gauge_mm"),
        Served(name="nominal_gauge_mm", scale=IN_MM, example=1435.0),
    ]
    length_m: Annotated[float, Interval(ge=1.0), Served("Length of the section.")]
    line: Annotated[SectionLine | None, Key(None)] = None
    tonnage_mgt_per_year: Annotated[
        Annotated[float, Interval(gt=0.0, le=MOST_TONNAGE_MGT)] | None,
        Served("Traffic, million gross tonnes a year. Null: the registry does not say.", example=18.0),
    ] = None

    def __post_init__(self) -> None:
        if self.line is not None:  # lists, as JSON has them
            object.__setattr__(self, "line", tuple((s, north, east) for s, north, east in self.line))


@dataclass(frozen=True, slots=True)
class AlignmentRecord:
    """A version of a section's alignment without its arrays.

    ``same_since`` is the oldest version from which it differs by less than that one left unknown: what was estimated
    with any version since then need not be estimated again. ``superseded_ns`` is when it ceased to follow from what is
    stored; None while it does.
    """

    section: str
    version: int
    status: Status
    source: Annotated[AlignmentSource, Served(example="fleet")]
    same_since: Annotated[int, Served("It differs from this one by less than that left unknown.", "same_since_version")]
    cut_off_m: Annotated[float, Served("Longer wavelengths are not in it; null where all are.", finite=False)]
    scale_std: Annotated[
        float, Served("Relative, of a common stretch that it leaves open.", "scale_std_1", finite=False)
    ]
    gauge_known: bool
    alignment_std_m: Annotated[
        float | None,
        Served("Median along the section; null of a recording as registered.", "alignment_std_mm", IN_MM),
    ]
    points: Annotated[int, Served("Number of positions.")]
    recorded_ns: int | None
    superseded_ns: int | None = None


@dataclass(frozen=True, slots=True)
class SectionStanding:
    """Versions of a section: in force, registered last, and of its newest layout; None where there is none."""

    in_force: AlignmentRecord | None = None
    registered: int | None = None
    layout: int | None = None


@dataclass(frozen=True, slots=True)
class TrackReport:
    """What a run of the alignment job found of a section; ``version`` is the one in force afterwards, if any."""

    section: str
    version: Annotated[int | None, Served("In force after that run; null where there is none yet.")]
    made: Annotated[bool, Served("Whether that run made the version.", "made_version")]
    status: Status
    reason: Annotated[Reason | None, Served("Why nothing is estimated, or why an estimate has not converged.")]
    windows: Annotated[int, Served(name="n_windows")]
    input_digest: str  # over keys and digests of windows, and the version before
    code_version: str
    report: Mapping[str, JsonValue]
    recorded_ns: int
    report_id: int = 0


@dataclass(frozen=True, slots=True)
class Correction:
    """True position = measured + offset + scale (measured - middle)."""

    offset: float = 0.0  # m
    scale: float = 0.0
    middle: float = 0.0  # m

    def at(self, measured: FloatArray) -> FloatArray:
        """Return corrected positions, m."""
        return np.asarray(measured + self.offset + self.scale * (measured - self.middle))

    def moved(self, offset: float, scale: float) -> Correction:
        """Return the correction with more of both."""
        return replace(self, offset=self.offset + offset, scale=self.scale + scale)


@dataclass(frozen=True, slots=True)
class FoldState:
    """What is known of a section after some of its epochs."""

    version: int | None  # of the alignment in force; None where there is none
    same_since: int | None  # oldest version of the chain from which it does not differ materially
    survey: Reason | None = None  # what the fleet has found of the survey; None where it was not checked

    def key(self, given: str) -> str:
        """Return what distinguishes this state as the start of an epoch; ``given`` is what all epochs rest on."""
        survey = "" if self.survey is None else f"{self.survey.code} {self.survey.text}"
        return f"{given} {self.version} {self.same_since} {survey}"


@dataclass(frozen=True, slots=True)
class TrackEpoch:
    """One epoch of a section as it was computed last. Key: (section, number), from 1 in vehicle time."""

    section: str
    number: int
    before: str  # key of the state that it started from
    input_digest: str  # of the windows that it rests on, with what is assumed of each
    horizon_ns: int  # up to when another window would change which windows are its own
    windows: int
    waits: bool  # it identified nothing: its windows are looked at again together with those of the next
    after: FoldState  # what is known after it
    estimated_on: int | None  # version of its windows, as long as the last one does not differ materially
    report: int  # number of its report
    recorded_ns: int
    stale: bool = False  # a window that it holds has gone since, or where that was has been forgotten


@dataclass(frozen=True, slots=True)
class FoundOfVehicles:
    """Of which vehicles an epoch has found what matters for their windows alone."""

    version: int  # that holds it: windows of these vehicles are estimated on no older one
    stiffness_ratio: Mapping[str, float] = field(default_factory=dict)  # as that version has it; 1 without


@dataclass(frozen=True, slots=True)
class EpochMember:
    """A window of an epoch, as it was when the epoch was computed."""

    record: WindowRecord
    context: str  # digest of all that is on file of its wheelset on its vehicle
    assumed: str  # digest of what of it concerns this window


@dataclass(frozen=True, slots=True)
class HeldWindow:
    """What an epoch holds of a window. Fields as of the window that it was computed with."""

    section: str
    epoch: int
    vehicle: str
    content_digest: str
    mileage_km: float
    assumed: str  # as in EpochMember


@dataclass(frozen=True, slots=True)
class ListedWindow:
    """A window that may not be held by an epoch as it is now."""

    start_ns: int
    record: WindowRecord | None  # None where it is gone
    held: HeldWindow | None  # by an epoch of whatever section; None where by none


def evidence_of_measurement(name: str) -> str:
    """Return what stands for a measurement of wheels."""
    return f"measured profiles of {name}"


def evidence_of_version(source: str, version: int) -> str:
    """Return what stands for an alignment that was known before."""
    return f"{source} version {version}"


class Iterated(StrEnum):
    """What is iterated."""

    POSITIONS = "positions"
    STIFFNESS_RATIOS = "stiffness_ratios"
    GAUGE_STEP = "gauge_step"
    GAUGE = "gauge"


@dataclass(frozen=True, slots=True)
class Convergence:
    """How the iteration of one quantity ended."""

    of: Iterated
    converged: bool
    rounds: int
    change: float  # by the last round: m of positions and gauge, relative of stiffness ratios; NaN of a linear solve
