"""Whether the intervals of the estimates cover what was measured, over a fleet."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from pydantic import Field

from api.accuracy.placed import Placed
from api.schemas.common import Links, Representation, Uncertain, uncertain
from api.schemas.comparison import comparison_path
from api.schemas.geometry import MM
from api.schemas.registry import segment
from api.times import Timestamp, to_rfc3339
from estimation.accuracy.coverage import CoverageCount
from estimation.accuracy.fleet_accuracy import CoveragePair, FleetAccuracy, Outcome, PlacedComparison
from estimation.trend.extrapolation import LIMIT_AMPLITUDE
from estimation.values.reasons import ReasonCode, code_of, text_of


class Coverage(Representation):
    """How many 95 % intervals cover what was measured; those without estimate or measurement are not counted."""

    compared: int = Field(description="Intervals that were compared with a measurement.")
    covered: int = Field(description="Of these, the ones that cover it.")
    fraction_1: float | None = Field(description="Share that is covered; null where nothing was compared.")
    fraction_interval_95_1: tuple[float, float] | None = Field(
        description="95 % interval of the share (Clopper and Pearson), as if comparisons were independent."
    )


class CoverageOfGroup(Representation):
    """The coverage of some comparisons, and of those that check the product."""

    everything: Coverage = Field(description="Of all comparisons.")
    independent: Coverage = Field(
        description="Of those whose estimate was made without a measurement of the same profiles."
    )


class CoverageAtAmplitude(CoverageOfGroup):
    """The coverage at one amplitude."""

    amplitude_mm: float


class CoverageOfKey(CoverageOfGroup):
    """The coverage of one vehicle class or track section."""

    key: str = Field(description="Code of the class or section.")


class NotCompared(Representation):
    """How many measurements are not compared at 3 mm for one reason."""

    reason_code: ReasonCode
    measurements: int = Field(description="How many.")


class MeasurementRow(Representation):
    """One measurement: whether the interval of the estimate covers its conicity at 3 mm."""

    wheelset: str = Field(examples=["WS-0001"])
    measured_at: Timestamp
    mileage_km: float
    vehicle_class: str | None = Field(description="Of the vehicle that it was mounted on; null where it was on none.")
    track_sections: list[str] = Field(description="Those that the estimate is of.")
    outcome: Outcome = Field(description="Whether it is covered, or not compared and why.")
    independent: bool | None = Field(
        description="Whether the estimate was made without a measurement of the same profiles; null without estimate."
    )
    measured_1: Uncertain = Field(description="Equivalent conicity at 3 mm of the measured profiles.")
    estimated_1: Uncertain = Field(description="Equivalent conicity at 3 mm of the estimate.")
    reason: str | None = Field(description="Why it is not compared; null where it is.")
    reason_code: ReasonCode | None
    links: Links


class Unreadable(Representation):
    """A wheelset of which something stored is damaged."""

    wheelset: str = Field(examples=["WS-0001"])
    reason: str = Field(description="What cannot be read.")
    reason_code: ReasonCode


class Accuracy(Representation):
    """Estimates against measurements over a fleet: whether the 95 % intervals cover, and which do not."""

    amplitude_mm: float = Field(description="Of the conicity that is compared: that of limits.")
    on_file: int = Field(description="Measurements on file that fit the filter.")
    considered: int = Field(description="The newest of these, as many as `limit` allows; what follows is of them.")
    coverage: CoverageOfGroup = Field(description="At 3 mm.")
    coverage_by_amplitude: list[CoverageAtAmplitude] = Field(description="At 1 to 8 mm.")
    coverage_by_vehicle_class: list[CoverageOfKey] = Field(description="At 3 mm, by class of the vehicle.")
    coverage_by_track_section: list[CoverageOfKey] = Field(
        description="At 3 mm, by section; an estimate of several sections counts in each."
    )
    not_compared: list[NotCompared] = Field(description="Measurements that are not compared at 3 mm, by reason.")
    measurements: list[MeasurementRow] = Field(description="Each measurement, the newest first.")
    unreadable: list[Unreadable] = Field(
        description="Wheelsets left out of all that is above, because something stored of them is damaged."
    )
    links: Links


def accuracy(found: FleetAccuracy, placed: Placed, on_file: int, links: Mapping[str, str]) -> Accuracy:
    """Return the representation of what the comparisons of a fleet add up to."""
    return Accuracy(
        amplitude_mm=LIMIT_AMPLITUDE * MM,
        on_file=on_file,
        considered=len(placed.rows),
        coverage=CoverageOfGroup(**_pair(found.at_limit)),
        coverage_by_amplitude=[
            CoverageAtAmplitude(amplitude_mm=round(a * MM, 3), **_pair(pair)) for a, pair in found.by_amplitude.items()
        ],
        coverage_by_vehicle_class=[CoverageOfKey(key=k, **_pair(pair)) for k, pair in found.by_vehicle_class.items()],
        coverage_by_track_section=[CoverageOfKey(key=k, **_pair(pair)) for k, pair in found.by_section.items()],
        not_compared=[NotCompared(reason_code=code, measurements=n) for code, n in found.not_compared.items()],
        measurements=[_row(row) for row in placed.rows],
        unreadable=[
            Unreadable(wheelset=serial, reason=reason.text, reason_code=reason.code)
            for serial, reason in placed.unreadable.items()
        ],
        links=dict(links),
    )


def table(rows: Sequence[MeasurementRow]) -> tuple[Sequence[str], list[Sequence[object]]]:
    """Return the measurements as a header and rows."""
    header = ["wheelset", "measured_at", "mileage_km", "vehicle_class", "track_sections", "outcome", "independent"]
    header += ["measured_1", "measured_std_1", "estimated_1", "estimated_low_1", "estimated_high_1", "reason_code"]
    return header, [
        (
            *(row.wheelset, row.measured_at, row.mileage_km, row.vehicle_class, " ".join(row.track_sections)),
            *(row.outcome.value, None if row.independent is None else str(row.independent).lower()),
            *(row.measured_1.value, row.measured_1.std, row.estimated_1.value),
            *(row.estimated_1.interval_95 or (None, None)),
            None if row.reason_code is None else row.reason_code.value,
        )
        for row in rows
    ]


def _pair(pair: CoveragePair) -> dict[str, Coverage]:
    return {"everything": _coverage(pair.all), "independent": _coverage(pair.independent)}


def _coverage(count: CoverageCount) -> Coverage:
    return Coverage(
        compared=count.compared,
        covered=count.covered,
        fraction_1=count.fraction,
        fraction_interval_95_1=count.interval_95,
    )


def _row(row: PlacedComparison) -> MeasurementRow:
    found = row.comparison
    one = found.measurement
    return MeasurementRow(
        wheelset=one.wheelset,
        measured_at=to_rfc3339(one.at_ns),
        mileage_km=one.mileage_km,
        vehicle_class=row.vehicle_class,
        track_sections=list(row.sections),
        outcome=row.outcome,
        independent=found.independent,
        measured_1=uncertain(found.at_limit.measured),
        estimated_1=uncertain(found.at_limit.estimated),
        reason=text_of(found.reason),
        reason_code=code_of(found.reason),
        links={
            "wheelset": f"/v1/wheelsets/{segment(one.wheelset)}",
            "comparison": comparison_path(one.wheelset, one.at_ns),
        },
    )
