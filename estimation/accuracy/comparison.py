"""A measurement of a wheelset's profiles beside the estimate that belongs to it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from estimation.accuracy.coverage import covers
from estimation.accuracy.estimate_of_date import EstimateOfDate
from estimation.accuracy.wheel_contact import AMPLITUDES, WheelContact
from estimation.contact.profiles import MeasuredProfiles
from estimation.trend.extrapolation import LIMIT_AMPLITUDE, SAME_AMPLITUDE, conicity_at_limit_amplitude
from estimation.values.geometry import GeometryRecord
from estimation.values.quantities import Estimate
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.served import Served

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
    measurement: MeasuredProfiles,
    contact: WheelContact | Reason,
    estimate: EstimateOfDate,
    *,
    independent: bool | None,
) -> Comparison:
    """Return a measurement beside the estimate that belongs to it.

    Args:
        contact: What follows from it, or why nothing does.
        independent: Whether the estimate was made without a measurement of the same wheels; None without an estimate.
    """
    if isinstance(contact, Reason):
        measured = dict.fromkeys(map(_key, AMPLITUDES), Estimate.unknown(contact))
    else:
        measured = dict(zip(map(_key, contact.amplitude), contact.conicity, strict=True))
    estimated = _estimated(estimate)
    pairs = (ConicityPair(float(a), measured[_key(a)], estimated[_key(a)]) for a in AMPLITUDES)
    return Comparison(measurement, contact, estimate, independent, tuple(pairs))


def _estimated(estimate: EstimateOfDate) -> Mapping[int, Estimate]:
    """Return the estimated conicity at each amplitude; at that of limits it may be extrapolated."""
    if estimate.record is None:
        return dict.fromkeys(map(_key, AMPLITUDES), Estimate.unknown(estimate.reason or _NO_ESTIMATE))
    return {_key(a): _at(estimate.record, float(a)) for a in AMPLITUDES}


def _at(record: GeometryRecord, amplitude: float) -> Estimate:
    geometry = record.geometry
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
