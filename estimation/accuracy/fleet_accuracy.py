"""Estimates beside measured wheels, and over a fleet: how many intervals covered what was measured."""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Annotated

import numpy as np

from estimation.accuracy.clustered_share import share_interval
from estimation.accuracy.parameters import ACCURACY
from estimation.accuracy.wheel_contact import AMPLITUDES, WheelContact
from estimation.contact.profiles import MeasuredProfiles
from estimation.trend.extrapolation import LIMIT_AMPLITUDE, SAME_AMPLITUDE, conicity_at_limit_amplitude
from estimation.values.arrays import FloatArray
from estimation.values.fields import Served
from estimation.values.geometry import GeometryRecord, WheelsetGeometry
from estimation.values.quantities import Estimate, Status, standardised
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.registry import WheelsetRecord
from estimation.values.trend import IdentityChange
from estimation.values.units import NORMAL_95


@dataclass(frozen=True, slots=True)
class EstimateOfDate:
    """The estimate that belongs to a measurement; ``reason`` is why there is none, or why it holds no number."""

    record: GeometryRecord | None
    reason: Reason | None


def baseline_at(wheelset: WheelsetRecord, at_ns: int) -> tuple[int, float]:
    """Return the number of reprofilings up to and at a time, and the mileage of the last of them (0 without any)."""
    turned = [item for item in wheelset.reprofilings if item.at_ns <= at_ns]
    return len(turned), max(turned, key=lambda item: item.at_ns).mileage_km if turned else 0.0


def estimate_of_date(
    measurement: MeasuredProfiles,
    wheelset: WheelsetRecord,
    intervals: Sequence[GeometryRecord],
    interval_km: float,
    change: IdentityChange | None = None,
) -> EstimateOfDate:
    """Return the estimate that belongs to a measurement, or why there is none."""
    # It is that of the mileage interval which contains the measurement, since the last reprofiling before it and with
    # no data of after the next. Where that interval has no conicity it is the nearest one that has, if its mileage is
    # within an interval of the measurement: in that distance a profile hardly wears.
    baseline, begin_km = baseline_at(wheelset, measurement.at_ns)
    of_baseline = [r for r in intervals if r.baseline == baseline and r.interval is not None and r.geometry.windows]
    if not of_baseline:
        since = "the wheelset was new" if baseline == 0 else f"reprofiling {baseline}"
        return EstimateOfDate(None, Reason(ReasonCode.NO_GEOMETRY, f"nothing was estimated since {since}"))
    same_side = [record for record in of_baseline if _same_side(record, measurement.at_ns, change)]
    if not same_side:
        text = "all estimates of this profile are of another wheelset, or of one mounted the other way round"
        return EstimateOfDate(None, Reason(ReasonCode.IDENTITY_DOUBTFUL, text))
    containing = int((measurement.mileage_km - begin_km) // interval_km)
    chosen = next((record for record in same_side if record.interval == containing), None)

    def apart(record: GeometryRecord) -> float:
        return abs(record.mileage_km - measurement.mileage_km)

    if chosen is None or not _has_conicity(chosen):
        near = [record for record in same_side if _has_conicity(record) and apart(record) <= interval_km]
        chosen = min(near, key=apart, default=chosen)
    if chosen is None:
        text = f"the nearest estimate of this profile is {min(map(apart, same_side)):.0f} km from the measurement"
        return EstimateOfDate(None, Reason(ReasonCode.NO_ESTIMATE_NEAR, text))
    if _has_conicity(chosen):
        return EstimateOfDate(chosen, None)
    return EstimateOfDate(chosen, chosen.geometry.reason or chosen.geometry.equivalent_conicity.reason)


def _has_conicity(record: GeometryRecord) -> bool:
    return any(estimate.status is Status.ESTIMATED for estimate in record.geometry.conicity)


def _same_side(record: GeometryRecord, at_ns: int, change: IdentityChange | None) -> bool:
    if change is None:
        return True
    if at_ns >= change.after_ns:
        return record.from_ns >= change.after_ns
    return record.to_ns <= change.before_ns


_NO_ESTIMATE = Reason(ReasonCode.NO_GEOMETRY, "there is no estimate")


@dataclass(frozen=True, slots=True)
class ConicityPair:
    """The equivalent conicity at one amplitude, measured and estimated."""

    amplitude: float  # m
    measured: Annotated[Estimate, Served("From the measured profiles; `n_windows` is 0.", "measured_1")]
    estimated: Annotated[
        Estimate, Served("Of the estimate; at 3 mm it may be extrapolated, see its reason.", "estimated_1")
    ]

    @property
    def covered(
        self,
    ) -> Annotated[
        bool | None,
        Served(
            "Whether the estimate's 95 % interval, widened by the error of the measurement, covers it; "
            "null where either is unknown."
        ),
    ]:
        """Whether the interval of the estimate covers the measurement; None where either is unknown."""
        return covers(self.estimated, self.measured)

    @property
    def z(
        self,
    ) -> Annotated[
        float | None,
        Served(
            "Estimate less measurement over the standard deviation of both; null where either is unknown.",
            "z_1",
        ),
    ]:
        """Estimate less measurement over the standard deviation of both; None where either is unknown."""
        return standardised(self.estimated, self.measured)


@dataclass(frozen=True, slots=True)
class Comparison:
    """A measurement, the estimate of its date, and the conicities of both.

    ``independent`` is whether the estimate was made without any measurement of the same wheels; None where there is
    no estimate. ``contact`` is a reason where the profiles have no contact geometry.
    """

    measurement: MeasuredProfiles
    contact: WheelContact | Reason
    estimate: EstimateOfDate
    independent: bool | None
    conicity: tuple[ConicityPair, ...]

    @property
    def at_limit(self) -> ConicityPair:
        """The pair at the amplitude of limits, 3 mm."""
        return next(one for one in self.conicity if abs(one.amplitude - LIMIT_AMPLITUDE) < SAME_AMPLITUDE)

    @property
    def reason(self) -> Reason | None:
        """Why the conicity at 3 mm is not compared; None where it is."""
        pair = self.at_limit
        if pair.covered is not None:
            return None
        return pair.measured.reason or self.estimate.reason or pair.estimated.reason or _NO_ESTIMATE


def compared(
    measurement: MeasuredProfiles, contact: WheelContact | Reason, estimate: EstimateOfDate, *, independent: bool | None
) -> Comparison:
    """Return a measurement beside the estimate that belongs to it."""
    if isinstance(contact, Reason):
        measured = dict.fromkeys(map(_key, AMPLITUDES), Estimate.unknown(contact))
    else:
        measured = dict(zip(map(_key, contact.amplitude), contact.conicity, strict=True))
    pairs = (ConicityPair(a, measured[_key(a)], _estimated(estimate, a)) for a in AMPLITUDES.tolist())
    return Comparison(measurement, contact, estimate, independent, tuple(pairs))


def _estimated(estimate: EstimateOfDate, amplitude: float) -> Estimate:
    if estimate.record is None:
        return Estimate.unknown(estimate.reason or _NO_ESTIMATE)
    geometry = estimate.record.geometry
    if abs(amplitude - LIMIT_AMPLITUDE) < SAME_AMPLITUDE:
        return conicity_at_limit_amplitude(geometry)
    near = np.flatnonzero(np.abs(geometry.amplitude - amplitude) < SAME_AMPLITUDE)
    if len(near):
        return geometry.conicity[int(near[0])]
    if geometry.reason is not None:
        return Estimate.unknown(geometry.reason, geometry.windows)
    text = f"amplitude {1e3 * amplitude:g} mm is not estimated"
    return Estimate.unknown(Reason(ReasonCode.AMPLITUDE_NOT_COVERED, text), geometry.windows)


def _key(amplitude: float) -> int:
    return round(amplitude / SAME_AMPLITUDE)


def covers(estimated: Estimate, measured: Estimate) -> bool | None:
    """Return whether the 95 % interval of an estimate covers a measured value; None where either is unknown."""
    # the measurement errs too: the half of the interval on its side and 1.96 of its standard deviations are added as
    # squares
    if estimated.value is None or estimated.low is None or estimated.high is None:
        return None
    if measured.value is None or measured.std is None:
        return None
    difference = measured.value - estimated.value
    half = estimated.high - estimated.value if difference > 0.0 else estimated.value - estimated.low
    return abs(difference) <= math.hypot(half, NORMAL_95 * measured.std)


@dataclass(frozen=True, slots=True)
class CoverageCount:
    """How many intervals were compared with a measurement, how many covered it, and how large z was.

    ``interval_95`` is the 95 % interval of the share, None without a comparison.
    """

    compared: Annotated[int, Served("Intervals that were compared with a measurement.")] = 0
    covered: Annotated[int, Served("Of these, the ones that cover it.")] = 0

    z_rms: Annotated[
        float | None,
        Served(
            "Root mean square of z: 1 where standard deviations are as large as errors are; null where nothing was"
            " compared.",
            "z_rms_1",
        ),
    ] = None
    mean_z: Annotated[
        float | None,
        Served(
            "Mean of z: 0 where estimates are neither too high nor too low; null where nothing was compared.",
            "mean_z_1",
        ),
    ] = None
    interval_95: tuple[float, float] | None = None

    @classmethod
    def of(cls, pairs: Iterable[tuple[str, ConicityPair]]) -> CoverageCount:
        """Return the count of some conicities, each of a wheelset; what is not known on both sides is not counted."""
        by_wheelset: defaultdict[str, list[bool]] = defaultdict(list)
        z: list[float] = []
        for serial, pair in pairs:
            if pair.covered is not None:
                by_wheelset[serial].append(pair.covered)
                z += [] if pair.z is None else [pair.z]
        clusters = [(len(covered), sum(covered)) for covered in by_wheelset.values()]
        return cls(
            compared=sum(number for number, _ in clusters),
            covered=sum(covered for _, covered in clusters),
            z_rms=float(np.sqrt(np.mean(np.square(z)))) if z else None,
            mean_z=float(np.mean(z)) if z else None,
            interval_95=share_interval(clusters, ACCURACY.tail_probability),
        )

    @property
    def fraction(
        self,
    ) -> Annotated[float | None, Served("Share that is covered; null where nothing was compared.", "fraction_1")]:
        """Share that is covered; None where nothing was compared."""
        return self.covered / self.compared if self.compared else None


class Outcome(StrEnum):
    """Whether an interval covered a measured conicity at 3 mm."""

    COVERED = "covered"
    NOT_COVERED = "not_covered"
    NOT_COMPARED = "not_compared"


@dataclass(frozen=True, slots=True)
class PlacedComparison:
    """A comparison with where the wheelset ran."""

    comparison: Comparison
    vehicle_class: str | None  # of the vehicle at the measurement; None where it was on none
    sections: tuple[str, ...]  # those that the estimate is of

    @property
    def outcome(self) -> Outcome:
        """Whether the estimate's interval covers the measured conicity at 3 mm."""
        covered = self.comparison.at_limit.covered
        if covered is None:
            return Outcome.NOT_COMPARED
        return Outcome.COVERED if covered else Outcome.NOT_COVERED


@dataclass(frozen=True, slots=True)
class CoveragePair:
    """A count of all comparisons, and of those whose estimate was made without a measurement of the same wheels."""

    all: Annotated[CoverageCount, Served("Of all comparisons.", "everything")]
    independent: Annotated[
        CoverageCount, Served("Of those whose estimate was made without a measurement of the same profiles.")
    ]


@dataclass(frozen=True, slots=True)
class FleetAccuracy:
    """What the comparisons of a fleet add up to; at 3 mm where no amplitude is named."""

    at_limit: CoveragePair
    by_amplitude: Mapping[float, CoveragePair]  # m
    by_vehicle_class: Mapping[str, CoveragePair]
    by_section: Mapping[str, CoveragePair]  # an estimate of several sections counts in each
    not_compared: Mapping[ReasonCode, int]


def fleet_accuracy(rows: Sequence[PlacedComparison]) -> FleetAccuracy:
    """Return what some comparisons add up to."""
    reasons = [row.comparison.reason for row in rows]
    return FleetAccuracy(
        at_limit=_count(rows),
        by_amplitude={float(a): _count(rows, index) for index, a in enumerate(AMPLITUDES)},
        by_vehicle_class=_grouped(rows, lambda row: [row.vehicle_class] if row.vehicle_class is not None else []),
        by_section=_grouped(rows, lambda row: row.sections),
        not_compared=dict(sorted(Counter(reason.code for reason in reasons if reason is not None).items())),
    )


def _count(rows: Iterable[PlacedComparison], index: int | None = None) -> CoveragePair:
    comparisons = [row.comparison for row in rows]
    alone = [comparison for comparison in comparisons if comparison.independent]
    return CoveragePair(*(CoverageCount.of(_pairs(some, index)) for some in (comparisons, alone)))


def _pairs(comparisons: Iterable[Comparison], index: int | None) -> Iterator[tuple[str, ConicityPair]]:
    for one in comparisons:
        yield one.measurement.wheelset, one.at_limit if index is None else one.conicity[index]


def _grouped(
    rows: Iterable[PlacedComparison], keys: Callable[[PlacedComparison], Iterable[str]]
) -> dict[str, CoveragePair]:
    groups: defaultdict[str, list[PlacedComparison]] = defaultdict(list)
    for row in rows:
        for key in keys(row):
            groups[key].append(row)
    return {key: _count(members) for key, members in sorted(groups.items())}


@dataclass(frozen=True, slots=True)
class CurveOrigin:
    """The point of a known curve from which the estimated one is counted."""

    displacement: float  # m
    difference: float  # rL - rR there, m


def curve_origin(
    found: WheelsetGeometry, displacement: FloatArray, difference: FloatArray, crossing: float
) -> CurveOrigin:
    """Return the point of a known curve rL - rR from which an estimated one is counted."""
    # The estimated curve has its origin at the mean of both: it may be anywhere along the known curve, with its own R
    # zero on average. The place where it fits best is taken; a wheelset of unlike wheels runs nearer to the track
    # centre than its zero crossing is.
    centre, R = found.bin_centres, found.rolling_radius_difference
    estimated = np.isfinite(R.value)
    if not estimated.any():
        return CurveOrigin(crossing, 0.0)
    best = (np.inf, crossing, 0.0)
    low, high = min(crossing, 0.0) - ACCURACY.search_reach, max(crossing, 0.0) + ACCURACY.search_reach
    for shift in np.linspace(low, high, round((high - low) / ACCURACY.search_step) + 1):
        curve = np.interp(centre + shift, displacement, difference)
        mean = float(found.samples @ curve / found.samples.sum())
        deviation = (R.value - curve + mean)[estimated] / R.std[estimated]
        misfit = float(np.minimum(deviation**2, ACCURACY.most_bin_stds**2).sum())
        best = min(best, (misfit, float(shift), mean))
    return CurveOrigin(best[1], best[2])
