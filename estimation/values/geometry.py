"""Bin tables, and the geometry of a wheelset that follows from them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Annotated, Any, NamedTuple

import numpy as np

from estimation.values.arrays import FloatArray, FrozenArrays, IntArray, bin_centres, freeze
from estimation.values.error_parts import ErrorSource, varying_stds
from estimation.values.fields import JsonValue, Served, in_mm
from estimation.values.quantities import Estimate, Status
from estimation.values.reasons import Reason
from estimation.values.runs import Result, ResultKind, SubjectKind
from estimation.values.units import IN_MM, NORMAL_95
from estimation.values.windows import OfWindow


@dataclass(frozen=True, slots=True)
class BinTable(FrozenArrays):
    """Mergeable sufficient statistics of the piecewise least squares, per bin of lateral displacement and group.

    Groups are what standard deviations come from: blocks of running time are assigned to ``g`` groups, and any derived
    number is recomputed with one group left out (delete-a-group jackknife). ``lateral`` and ``yaw`` hold, per group and
    bin, the packed moments that ``estimation.tables.bin_table`` lays out.
    """

    parameter_key: str  # digest of every parameter that shapes the statistics
    edges: Annotated[FloatArray, "b + 1"]  # m
    weight: Annotated[FloatArray, "g", "b"]  # sum of weights; the sample count without forgetting
    lateral: Annotated[FloatArray, "g", "b", None]  # regressors [x1, x1 u, x2, x2 u], targets z1, its sensitivities
    yaw: Annotated[FloatArray, "g", "b", None]  # regressors [(l W/2) psi, c, c u, c u^2], targets z2, its sensitivities
    samples: int  # samples ever added, without weights
    windows: int

    @property
    def centres(self) -> FloatArray:
        """Bin centres (b,), m."""
        return bin_centres(self.edges)

    @property
    def without_samples(self) -> BinTable:
        """The table of the same parameters without samples."""
        none = {name: np.zeros_like(getattr(self, name)) for name in ("weight", "lateral", "yaw")}
        return replace(self, samples=0, windows=0, **none)


@dataclass(frozen=True, slots=True)
class FilledCells:
    """A bin table as it is stored: only its cells with samples, which are a tenth of all in a window of a minute."""

    parameter_key: str
    edges: Annotated[FloatArray, None]  # (b + 1,) m
    groups: int
    cells: Annotated[IntArray, "k"]  # group * b + bin of each cell, increasing
    weight: Annotated[FloatArray, "k"]
    lateral: Annotated[FloatArray, "k", None]
    yaw: Annotated[FloatArray, "k", None]
    samples: int
    windows: int

    def __post_init__(self) -> None:
        freeze(self)
        count = self.groups * (len(self.edges) - 1)
        if len(self.cells) and (self.cells[0] < 0 or self.cells[-1] >= count):
            raise ValueError(f"cells {self.cells[0]} to {self.cells[-1]} of {count}")

    def table(self) -> BinTable:
        """Return the table with its empty cells."""
        groups, bins = self.groups, len(self.edges) - 1

        def spread(rows: FloatArray) -> FloatArray:
            whole = np.zeros((groups * bins, *rows.shape[1:]))
            whole[self.cells] = rows
            whole.flags.writeable = False
            return whole.reshape(groups, bins, *rows.shape[1:])

        weight, lateral, yaw = (spread(rows) for rows in (self.weight, self.lateral, self.yaw))
        return BinTable(self.parameter_key, self.edges, weight, lateral, yaw, self.samples, self.windows)


@dataclass(frozen=True, slots=True)
class WindowTable(OfWindow):
    """The bin table of a window, and what it was made from."""

    wheelset: str
    start_ns: int
    window_digest: str  # of the content of the window
    table: BinTable | FilledCells
    track_version: int | None = None  # of the alignment


@dataclass(frozen=True, slots=True)
class TableKey:
    """Which parameters the bin tables of a wheelset on a vehicle were made with."""

    wheelset: str
    vehicle: str
    parameter_key: str


class BinStatus(StrEnum):
    """Why a bin's number is published or not."""

    ESTIMATED = "estimated"
    TOO_FEW = "too_few_samples"
    CONTACT_JUMP = "contact_jump"  # one crosses the bin
    UNOBSERVABLE = "unobservable"  # from the data


LEFT_OUT = "windows_left_out"
"""Key among the parameters of a current geometry: windows since the last reprofiling not believed, by reason."""
PASSED_OVER = "windows_passed_over"
"""Key among the parameters of a geometry: windows that would be others today, and cannot be made again, by cause."""
RADIUS_DOUBTED = "radius_doubted"
"""Key among the parameters of a geometry: what was in doubt of its radius on file, for when its samples are gone."""


class CentreOrigin(StrEnum):
    """From where the middle of the travel is counted that a conicity is about."""

    MEAN_RUNNING_POSITION = "mean_running_position"  # signals carry no offset
    TRACK_CENTRE = "track_centre"


@dataclass(frozen=True, slots=True)
class Centre:
    """The middle of the travel that the conicity is about; in EN 15302 it is the one about equal rolling radii."""

    displacement: Annotated[
        float,
        in_mm("Middle of the travel at `equivalent_conicity_amplitude_mm`, positive to the left.", "displacement_mm"),
    ]
    std: Annotated[
        float,
        in_mm(
            "Standard deviation of where both rolling radii are equal, against that: a bogie holds wheels "
            "of different diameters off it. What it changes is part of the intervals.",
            "rolling_line_std_mm",
        ),
    ]
    origin: Annotated[CentreOrigin, Served("From where the displacement is counted.")]


COMBINATIONS = ("rolling_radius_sum", "rolling_radius_difference", "contact_angle_sum", "contact_angle_difference")


@dataclass(frozen=True, slots=True)
class BinValues(FrozenArrays):
    """One of the four combinations over the bins; NaN where not estimated."""

    value: Annotated[FloatArray, "b"]  # m or rad
    std: Annotated[FloatArray, "b"]
    status: Annotated[tuple[BinStatus, ...], "b"]


@dataclass(frozen=True, slots=True)
class Contradiction:
    """What of the registry the data contradict, how sure that is, and how far off the conicity may be by it."""

    reason: Reason
    certain: bool  # nothing is published; else the number stands, wider, with the reason beside it
    relative: float  # std of the conicity, over itself


@dataclass(frozen=True, slots=True)
class WheelsetGeometry(FrozenArrays):
    """Contact geometry of one wheelset, estimated from its bin table."""

    bin_edges: Annotated[FloatArray, "b + 1"]  # m, lateral displacement y - d
    samples: Annotated[FloatArray, "b"]  # effective samples
    rolling_radius_sum: BinValues
    rolling_radius_difference: BinValues
    contact_angle_sum: BinValues
    contact_angle_difference: BinValues
    amplitude: Annotated[FloatArray, "n"]  # m
    conicity: Annotated[tuple[Estimate, ...], "n"]  # equivalent conicity at each amplitude
    reported_amplitude: Annotated[
        float, in_mm("3 mm, or the largest amplitude covered.", "equivalent_conicity_amplitude_mm")
    ]
    equivalent_conicity: Annotated[
        Estimate, Served("Equivalent conicity at `equivalent_conicity_amplitude_mm`.", "equivalent_conicity_1")
    ]  # at reported_amplitude
    # NP, 1/mm: (tan gamma_e(4 mm) - tan gamma_e(2 mm)) / 2
    nonlinearity: Annotated[
        Estimate,
        Served("Slope of the conicity against the amplitude at 3 mm (EN 15302).", "nonlinearity_parameter_per_mm"),
    ]
    zero_crossing: Annotated[
        Estimate, Served("Lateral displacement at which both rolling radii are equal.", "zero_crossing_mm", IN_MM)
    ]
    windows: Annotated[int, Served(name="n_windows")]
    parameter_key: str
    status: Status
    reason: Reason | None = None
    centre: Annotated[Centre | None, Served("The point the conicity is about; null without a conicity.")] = None
    # what the error of the conicity at each amplitude is made of
    error_sources: Annotated[tuple[ErrorSource, ...], "p"] = ()
    # (p, n) change per std, signed; NaN where the conicity is not known
    error_effects: Annotated[FloatArray, "p", None] = field(default_factory=lambda: np.zeros((0, 0)))

    @property
    def bin_centres(self) -> FloatArray:
        """Bin centres (b,), m."""
        return bin_centres(self.bin_edges)

    def against(self, found: Contradiction | None) -> WheelsetGeometry:
        """Return the geometry beside what contradicts its class: without numbers where that is certain, else wider."""
        if found is None or self.status is Status.MODEL_MISMATCH:
            return self
        return self.mismatched(found.reason) if found.certain else self._doubted(found)

    def _doubted(self, found: Contradiction) -> WheelsetGeometry:
        radius = self.rolling_radius_difference
        wider = np.hypot(radius.std, found.relative * np.abs(radius.value))
        return replace(
            self,
            rolling_radius_difference=replace(radius, std=wider),
            conicity=tuple(_doubted(one, found) for one in self.conicity),
            equivalent_conicity=_doubted(self.equivalent_conicity, found),
            nonlinearity=_doubted(self.nonlinearity, found),
            reason=self.reason or found.reason,
        )

    def mismatched(self, reason: Reason) -> WheelsetGeometry:
        """Return the geometry of a wheelset that does not follow the equations: no number is published."""
        nothing, b = np.full(len(self.samples), np.nan), len(self.samples)
        unknown = Estimate.unknown(reason, float(self.windows), Status.MODEL_MISMATCH)
        values: Any = BinValues(nothing, nothing, (BinStatus.UNOBSERVABLE,) * b)
        return replace(
            self,
            **dict.fromkeys(COMBINATIONS, values),
            conicity=(unknown,) * len(self.conicity),
            equivalent_conicity=unknown,
            nonlinearity=unknown,
            zero_crossing=unknown,
            status=Status.MODEL_MISMATCH,
            reason=reason,
            centre=None,
        )


def _doubted(estimate: Estimate, found: Contradiction) -> Estimate:
    if estimate.value is None or estimate.std is None or estimate.low is None or estimate.high is None:
        return estimate
    more = found.relative * abs(estimate.value)
    return replace(
        estimate,
        std=math.hypot(estimate.std, more),
        low=estimate.value - math.hypot(estimate.value - estimate.low, NORMAL_95 * more),
        high=estimate.value + math.hypot(estimate.high - estimate.value, NORMAL_95 * more),
        reason=estimate.reason or found.reason,
    )


GEOMETRY = ResultKind("geometry", SubjectKind.WHEELSET, WheelsetGeometry)
"""Geometries of wheelsets; their parts are baselines, and the mileage intervals of these."""


@dataclass(frozen=True, slots=True)
class GeometryRecord:
    """A geometry estimate with its provenance. Never changed; a later one with the same key supersedes it.

    Key: (wheelset, baseline, interval). ``baseline`` counts reprofilings before it; ``interval`` is the mileage
    interval since the baseline, and None for the current geometry (all windows since the baseline, with forgetting).
    """

    wheelset: Annotated[str, Served(example="WS-0001")]
    baseline: int
    interval: int | None
    mileage_km: Annotated[
        float, Served("Weighted mean mileage of its windows since the wheelset was new.", finite=False)
    ]
    from_ns: int
    to_ns: int
    geometry: WheelsetGeometry
    input_digest: str  # over keys, digests and mileages of windows, and track versions
    track_versions: Annotated[
        Mapping[str, Sequence[int]],
        Served("By section, the versions of its alignment that the windows were estimated with, increasing."),
    ]
    parameters: Annotated[Mapping[str, JsonValue], Served("Settings that shaped it, each under its name.")]
    code_version: str
    recorded_ns: int


@dataclass(frozen=True, slots=True)
class IntervalDigest:
    """What the newest geometry of an interval was made from, of how many windows, and why it holds no number."""

    input_digest: str
    windows: int
    reason: Reason | None = None


class KnownConicity(NamedTuple):
    """An equivalent conicity that is estimated, with its amplitude in m."""

    amplitude: float
    value: float
    std: float
    noise: float  # std of what differs from interval to interval; the rest of ``std`` all of a wheelset have in common


@dataclass(frozen=True, slots=True)
class IntervalConicities:
    """The known conicities of one interval of one wheelset by amplitude; ``reason`` is why there is none, else None."""

    baseline: int
    interval: int | None
    mileage_km: float
    from_ns: int
    to_ns: int
    windows: int
    input_digest: str
    code_version: str
    known: tuple[KnownConicity, ...]
    reason: Reason | None


def known_conicities(geometry: WheelsetGeometry) -> tuple[KnownConicity, ...]:
    """Return the conicities of a geometry that are estimated, in the order of their amplitudes."""
    pairs = list(zip(geometry.amplitude.tolist(), geometry.conicity, strict=True))
    if np.isfinite(geometry.reported_amplitude):
        pairs.append((geometry.reported_amplitude, geometry.equivalent_conicity))
    noise = varying_stds(geometry.error_sources, geometry.amplitude, geometry.error_effects)
    known = [
        KnownConicity(amplitude, estimate.value, estimate.std, min(noise.get(amplitude, math.inf), estimate.std))
        for amplitude, estimate in pairs
        if estimate.status is Status.ESTIMATED and estimate.value is not None and estimate.std is not None
    ]
    return tuple(sorted(known, key=lambda one: one.amplitude))


def why_no_conicity(geometry: WheelsetGeometry) -> Reason | None:
    """Return why a geometry has no conicity, of the conicity or else of the geometry; None where it has one."""
    return None if known_conicities(geometry) else geometry.equivalent_conicity.reason or geometry.reason


def interval_conicities(record: GeometryRecord) -> IntervalConicities:
    """Return the conicities of an interval's geometry."""
    geometry = record.geometry
    return IntervalConicities(
        baseline=record.baseline,
        interval=record.interval,
        mileage_km=record.mileage_km,
        from_ns=record.from_ns,
        to_ns=record.to_ns,
        windows=geometry.windows,
        input_digest=record.input_digest,
        code_version=record.code_version,
        known=known_conicities(geometry),
        reason=why_no_conicity(geometry),
    )


MOST_INTERVALS = 999_999
"""To each side of a baseline; the order of the parts as texts is that of the intervals."""


def part_of(baseline: int, interval: int | None) -> str:
    """Return the part of a geometry; without a number of the interval of the current one of the baseline."""
    return f"current.{baseline:04d}" if interval is None else f"{baseline:04d}.{interval + MOST_INTERVALS:07d}"


def key_of_part(part: str) -> tuple[int, int | None]:
    """Return baseline and interval; None is the current geometry."""
    first, _, second = part.partition(".")
    return (int(second), None) if first == "current" else (int(first), int(second) - MOST_INTERVALS)


def result_of_geometry(record: GeometryRecord) -> Result[WheelsetGeometry]:
    """Return a geometry as a result."""
    geometry = record.geometry
    why = why_no_conicity(geometry)
    return Result(
        subject=record.wheelset,
        part=part_of(record.baseline, record.interval),
        made_from=record.input_digest,
        numerics=record.code_version,
        recorded_ns=record.recorded_ns,
        value=geometry,
        status=geometry.status,
        reason=geometry.reason,
        head={
            "mileage_km": None if math.isnan(record.mileage_km) else float(record.mileage_km),
            "from_ns": record.from_ns,
            "to_ns": record.to_ns,
            "windows": geometry.windows,
            "track_versions": {section: list(versions) for section, versions in record.track_versions.items()},
            "conicities": [list(point) for point in known_conicities(geometry)],
            "no_conicity": None if why is None else [why.code.value, why.text],
        },
        parameters=record.parameters,
    )
