"""The trend of a wheelset's indicator since its last reprofiling."""

from __future__ import annotations

from collections.abc import Sequence

from pydantic import Field, JsonValue

from api.schemas.common import Links, Representation, Uncertain, finite, finite_list, uncertain
from api.schemas.registry import segment
from api.schemas.unestimated import UnestimatedBecause, unestimated_because
from api.times import Timestamp, times_to_rfc3339, to_rfc3339
from estimation.trend.extrapolation import QUANTITY, conicity_at_limit_amplitude
from estimation.values import trend as values
from estimation.values.geometry import GeometryRecord
from estimation.values.quantities import Estimate, Forecast, Status
from estimation.values.reasons import Reason, ReasonCode, code_of, text_of
from estimation.values.trend import TrendRecord
from estimation.values.window_reasons import WithoutEstimate

BEYOND = Reason(ReasonCode.BEYOND_HORIZON, "not reached within the forecast horizon")
_NO_CURRENT = Estimate.unknown(
    Reason(ReasonCode.NO_GEOMETRY_SINCE_REPROFILING, "no current geometry of the profile that the trend is of")
)
_NO_TREND = Reason(ReasonCode.TOO_FEW_POINTS, "the trend is not estimated")


class TrendPoints(Representation):
    """The indicator's history, column by column."""

    mileage_km: list[float | None]
    measured_at: list[Timestamp]
    value_1: list[float | None]
    std_1: list[float | None]


class DistanceForecast(Representation):
    """Quantiles of the distance still to run; null means beyond the horizon or unknown, and `reason` says which."""

    p10: float | None
    p50: float | None
    p90: float | None
    reason: str | None
    reason_code: ReasonCode | None


class DateForecast(Representation):
    """Quantiles of the date; null means beyond the horizon or unknown, and `reason` says which."""

    p10: Timestamp | None
    p50: Timestamp | None
    p90: Timestamp | None
    reason: str | None
    reason_code: ReasonCode | None


class TrendStep(Representation):
    """A sudden change of the indicator, which the trend begins behind."""

    before_km: float | None = Field(description="Mileage of the last interval before it.")
    after_km: float | None = Field(description="Mileage of the first interval behind it.")
    before_at: Timestamp = Field(description="End of the last data before it.")
    after_at: Timestamp = Field(description="Begin of the first data behind it.")
    size_1: Uncertain = Field(description="By how much the indicator has changed, at `amplitude_mm`.")
    level_before_1: float | None = Field(description="The indicator before it.")
    amplitude_mm: float | None = Field(description="Amplitude that size and level are of.")
    probability_1: float | None = Field(description="That there is a step there.")
    intervals_before: int = Field(description="Intervals before it.")
    intervals_behind: int = Field(description="Intervals behind it.")


class TrendProvenance(Representation):
    """What the trend was made from."""

    code_version: str
    input_digest: str
    parameters: dict[str, JsonValue] = Field(description="Settings that shaped it; empty where none were kept.")


class Trend(Representation):
    """An indicator since the last reprofiling, its robust slope, and when it reaches its limit.

    Without a trend the numbers are null, the points empty, and `reason` and `unestimated_because` explain it.
    """

    wheelset: str = Field(examples=["WS-0001"])
    quantity: str = Field(examples=["equivalent_conicity"])
    status: Status
    reason: str | None
    reason_code: ReasonCode | None
    unestimated_because: UnestimatedBecause | None = Field(
        description="Why nothing is estimated now, by the windows; null where there is a geometry, and with `as_of`."
    )
    converged: bool = Field(
        description="Whether the robust fits over distance and date stopped changing; true where nothing was fitted."
    )
    baseline: int
    recorded_at: Timestamp | None = Field(description="When it was recorded; null without a trend.")
    points: TrendPoints
    step: TrendStep | None = Field(
        description="The step that the trend begins behind; null where it begins with the profile."
    )
    current_1: Uncertain = Field(
        description="Equivalent conicity at 3 mm of the current geometry: `equivalent_conicity_at_3_mm_1` there."
    )
    current_mileage_km: float | None = Field(description="Mileage that the current geometry is of.")
    fitted_1: Uncertain = Field(description="The fitted curve at the last point, at the mileage of that point.")
    slope_1_per_1000_km: Uncertain
    slope_1_per_year: Uncertain
    limit_1: float | None
    distance_to_limit_km: DistanceForecast
    date_of_limit: DateForecast
    probability_over_limit_1: float | None = Field(description="That the limit is exceeded now; null means unknown.")
    provenance: TrendProvenance | None = Field(description="What it was made from; null without a trend.")
    links: Links


def distance_forecast(forecast: Forecast, unknown: Reason | None) -> DistanceForecast:
    """Return the quantiles of a distance.

    Args:
        forecast: km.
        unknown: Why one is missing; None where it is beyond the horizon.
    """
    p10, p50, p90 = finite(forecast.p10), finite(forecast.p50), finite(forecast.p90)
    reason = (unknown or BEYOND) if None in (p10, p50, p90) else None
    return DistanceForecast(p10=p10, p50=p50, p90=p90, reason=text_of(reason), reason_code=code_of(reason))


def _moment(t_ns: float | None) -> str | None:
    value = finite(t_ns)
    return None if value is None or abs(value) >= 2.0**63 else to_rfc3339(int(value))


def date_forecast(forecast: Forecast, unknown: Reason | None) -> DateForecast:
    """Return the quantiles of a date.

    Args:
        forecast: ns UTC.
        unknown: Why one is missing; None where it is beyond the horizon.
    """
    p10, p50, p90 = _moment(forecast.p10), _moment(forecast.p50), _moment(forecast.p90)
    reason = (unknown or BEYOND) if None in (p10, p50, p90) else None
    return DateForecast(p10=p10, p50=p50, p90=p90, reason=text_of(reason), reason_code=code_of(reason))


def trend(record: TrendRecord, current: GeometryRecord | None, without: WithoutEstimate | None = None) -> Trend:
    """Return the representation of a trend.

    Args:
        current: The current geometry of the wheelset; None where there is none.
        without: Why there is none, by its windows; None where there is one, and of a time that has passed.
    """
    found = record.trend
    reason = found.reason if without is None else without.reason
    of_now = None if current is None or current.baseline != record.baseline else current
    own = f"/v1/wheelsets/{segment(record.wheelset)}"
    recorded_ns = record.recorded_ns if current is None else max(record.recorded_ns, current.recorded_ns)
    unknown = (
        found.not_comparable or found.few_behind if found.status is Status.ESTIMATED else found.reason or _NO_TREND
    )
    return Trend(
        wheelset=record.wheelset,
        quantity=found.quantity,
        status=found.status,
        reason=text_of(reason),
        reason_code=code_of(reason),
        unestimated_because=None if without is None else unestimated_because(without),
        converged=found.converged,
        baseline=record.baseline,
        recorded_at=to_rfc3339(record.recorded_ns),
        points=TrendPoints(
            mileage_km=finite_list(found.mileage_km),
            measured_at=times_to_rfc3339(found.measured_ns),
            value_1=finite_list(found.value),
            std_1=finite_list(found.std),
        ),
        step=None if found.step is None else _step(found.step),
        current_1=uncertain(_NO_CURRENT if of_now is None else conicity_at_limit_amplitude(of_now.geometry)),
        current_mileage_km=None if of_now is None else finite(of_now.mileage_km),
        fitted_1=uncertain(found.fitted),
        slope_1_per_1000_km=uncertain(found.slope_per_1000_km),
        slope_1_per_year=uncertain(found.slope_per_year),
        limit_1=finite(found.limit),
        distance_to_limit_km=distance_forecast(found.distance_to_limit_km, unknown),
        date_of_limit=date_forecast(found.date_of_limit_ns, unknown),
        probability_over_limit_1=finite(found.probability_over_limit),
        provenance=TrendProvenance(
            code_version=record.code_version,
            input_digest=record.input_digest,
            parameters=dict(record.parameters),
        ),
        links={
            "self": f"{own}/trend",
            "as_recorded": f"{own}/trend?as_of={to_rfc3339(recorded_ns)}",
            "wheelset": own,
            "geometry": f"{own}/geometry",
            "alerts": f"/v1/alerts?wheelset={segment(record.wheelset)}",
        },
    )


def _step(found: values.TrendStep) -> TrendStep:
    return TrendStep(
        before_km=finite(found.before_km),
        after_km=finite(found.after_km),
        before_at=to_rfc3339(found.before_ns),
        after_at=to_rfc3339(found.after_ns),
        size_1=uncertain(found.size),
        level_before_1=finite(found.level_before),
        amplitude_mm=finite(1e3 * found.amplitude),
        probability_1=finite(found.probability),
        intervals_before=found.before,
        intervals_behind=found.behind,
    )


def no_trend(
    serial: str, baseline: int, reason: Reason, current: GeometryRecord | None, without: WithoutEstimate | None = None
) -> Trend:
    """Return the representation of a wheelset that has no trend.

    Args:
        current: Its current geometry; None where there is none.
        without: Why it has no geometry either, by its windows; None where it has one, and of a time that has passed.
    """
    own = f"/v1/wheelsets/{segment(serial)}"
    unknown, nowhere = Estimate.unknown(reason), Forecast(None, None, None)
    of_now = None if current is None or current.baseline != baseline else current
    return Trend(
        wheelset=serial,
        quantity=QUANTITY,
        status=Status.UNESTIMATED,
        reason=reason.text,
        reason_code=reason.code,
        unestimated_because=None if without is None else unestimated_because(without),
        converged=True,
        baseline=baseline,
        recorded_at=None,
        points=TrendPoints(mileage_km=[], measured_at=[], value_1=[], std_1=[]),
        step=None,
        current_1=uncertain(unknown if of_now is None else conicity_at_limit_amplitude(of_now.geometry)),
        current_mileage_km=None if of_now is None else finite(of_now.mileage_km),
        fitted_1=uncertain(unknown),
        slope_1_per_1000_km=uncertain(unknown),
        slope_1_per_year=uncertain(unknown),
        limit_1=None,
        distance_to_limit_km=distance_forecast(nowhere, reason),
        date_of_limit=date_forecast(nowhere, reason),
        probability_over_limit_1=None,
        provenance=None,
        links={
            "self": f"{own}/trend",
            "wheelset": own,
            "geometry": f"{own}/geometry",
            "alerts": f"/v1/alerts?wheelset={segment(serial)}",
        },
    )


def table(trend_: Trend) -> tuple[Sequence[str], list[Sequence[object]]]:
    """Return the points as a header and rows."""
    points = trend_.points
    header = ["mileage_km", "measured_at", "value_1", "std_1"]
    return header, list(zip(points.mileage_km, points.measured_at, points.value_1, points.std_1, strict=True))
