"""Trends of wear and of the suspension, and sudden changes in them.

Identity changes, when a wheelset on file stopped being the one that ran or the way round that it ran, are found by the
alert rule of this kind and kept in the evidence of its alerts. Data from both sides of a change are never merged.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Annotated, Protocol, TypeVar

import numpy as np

from estimation.values.alerts import Alert
from estimation.values.arrays import FloatArray, FrozenArrays, IntArray
from estimation.values.fields import JsonValue, Served, in_mm
from estimation.values.geometry import KnownConicity
from estimation.values.quantities import Estimate, Forecast, Status, with_interval
from estimation.values.reasons import Reason
from estimation.values.runs import History, ResultKind, SubjectKind


@dataclass(frozen=True, slots=True)
class TrendPoint:
    """One value of the indicator, from one stretch of running."""

    mileage_km: float  # since the wheelset was new
    measured_ns: int
    value: float
    std: float
    noise: float | None = None  # part of it that differs from point to point; None is all of it


@dataclass(frozen=True, slots=True)
class LevelCalibration:
    """What measured profiles of the same wheels say of the error that all points of a trend have in common."""

    profiles: Annotated[int, Served("Measured profiles that are used.")]
    contradicting: Annotated[int, Served("Those that are not: they differ by more than 4 stds of both.")]
    shift: Annotated[float, Served("By how much they move the level at the last point.", "shift_1")]
    std: Annotated[float, Served("Of the error that is left in common to all points.", "std_1")]
    measured: tuple[TrendPoint, ...]  # all of them, at the mileage of the estimate beside each


@dataclass(frozen=True, slots=True)
class TrendStep:
    """A sudden change of the indicator that wear does not explain; what was recorded within it is of neither side."""

    before_km: Annotated[float, Served("Mileage of the last interval before it.", finite=False)]
    after_km: Annotated[float, Served("Mileage of the first interval behind it.", finite=False)]
    before_ns: Annotated[int, Served("End of the last data before it.")]
    after_ns: Annotated[int, Served("Begin of the first data behind it.")]
    found_ns: int  # end of the data that showed it first
    size: Annotated[Estimate, Served("By how much the indicator has changed, at `amplitude_mm`.", "size_1")]
    level_before: Annotated[float, Served("The indicator before it.", "level_before_1", finite=False)]
    amplitude: Annotated[float, in_mm("Amplitude that size and level are of.", "amplitude_mm")]
    probability: Annotated[float, Served("That there is a step there.", "probability_1", finite=False)]
    before: Annotated[int, Served("Intervals before it.", "intervals_before")]
    behind: Annotated[int, Served("Intervals behind it.", "intervals_behind")]


@dataclass(frozen=True, slots=True)
class BeyondReached:
    """By how much conicities at the limit's amplitude are off what is extrapolated to it from a smaller one (m)."""

    amplitude: float
    error: float
    std: float


@dataclass(frozen=True, slots=True)
class OwnWear(FrozenArrays):
    """What the points of a wheelset alone say of rate and change of its wear, by length and wandering.

    The log likelihood of both, t, is ``evidence + moment t - t information t / 2``.
    """

    amplitude: float  # m, of the conicities
    information: Annotated[FloatArray, "n", 2, 2]
    moment: Annotated[FloatArray, "n", 2]
    evidence: Annotated[FloatArray, "n"]
    beyond: tuple[BeyondReached, ...] = ()  # where it reaches the limit's amplitude; ``std`` is the catalogue's


@dataclass(frozen=True, slots=True)
class WearComponent:
    """One of the ways in which wheelsets of a fleet wear: at ``rate + change exp(-age / length)``, which wanders."""

    weight: float
    length: float  # km; inf for a change that never dies out, ``change age``
    rate: float  # per km
    change: float  # per km; of one that never dies out per square of km
    rate_std: float
    change_std: float
    correlation: float
    wandering: float  # std of the rate, per km, per square root of km

    def per(self, distance: float) -> WearComponent:
        """Return it with another unit of distance, of so many km."""
        of_change = distance**2 if math.isinf(self.length) else distance
        return replace(
            self,
            length=self.length / distance,
            rate=self.rate * distance,
            change=self.change * of_change,
            rate_std=self.rate_std * distance,
            change_std=self.change_std * of_change,
            wandering=self.wandering * distance**1.5,
        )


@dataclass(frozen=True, slots=True)
class FleetWear:
    """What other wheelsets of its fleet say of the wear of one beforehand."""

    components: tuple[WearComponent, ...]
    others: int  # wheelsets that say it
    beyond: tuple[BeyondReached, ...] = ()  # what those say that reach the limit's amplitude; ``std`` is of one more


OWN_WEAR = ResultKind("own_wear", SubjectKind.WHEELSET, OwnWear, History.NEWEST)
FLEET_WEAR = ResultKind("fleet_wear", SubjectKind.WHEELSET, FleetWear, History.NEWEST)


@dataclass(frozen=True, slots=True)
class WearTrend(FrozenArrays):
    """An indicator since the last reprofiling or step, its robust slope, and when it reaches its limit."""

    quantity: Annotated[str, Served("Which quantity.", example="equivalent_conicity")]
    mileage_km: Annotated[FloatArray, "k"]  # since the wheelset was new
    measured_ns: Annotated[IntArray, "k", Served(name="measured_at")]
    value: Annotated[FloatArray, "k", Served(name="value_1")]
    std: Annotated[FloatArray, "k", Served(name="std_1")]
    noise: Annotated[FloatArray, "k", Served("Part of it that differs from point to point.", "noise_1")]
    slope_per_1000_km: Annotated[Estimate, Served("Change per 1,000 km.", "slope_1_per_1000_km")]
    slope_per_year: Annotated[Estimate, Served("Change per year.", "slope_1_per_year")]
    fitted: Annotated[Estimate, Served("The fitted curve at the last point, at the mileage of that point.", "fitted_1")]
    limit: Annotated[
        float, Served("The limit that the trend is compared with; null where there is none.", "limit_1", finite=False)
    ]
    distance_to_limit_km: Forecast  # from the last point; 0 where already reached
    date_of_limit_ns: Forecast
    probability_over_limit: Annotated[
        float | None, Served("That the limit is exceeded now; null means unknown.", "probability_over_limit_1")
    ]
    status: Status
    reason: Reason | None = None
    converged: Annotated[
        bool, Served("Whether the robust fits over distance and date stopped changing; true where nothing was fitted.")
    ] = True
    not_comparable: Reason | None = None  # why the limit is not held against it; None where it is
    step: Annotated[
        TrendStep | None, Served("The step that the trend begins behind; null where it begins with the profile.")
    ] = None
    few_behind: Reason | None = None  # why nothing is forecast: too few points behind the step; None where enough are
    ahead_km: Annotated[FloatArray, "a"] = field(default_factory=lambda: np.empty(0))  # from the last point, increasing
    over_ahead: Annotated[FloatArray, "a"] = field(default_factory=lambda: np.empty(0))  # P over the limit there
    fleet: FleetWear | None = None  # what was known of its wear beforehand; None for nothing
    origin_km: float | None = None  # mileage at which the profile began to wear; None is that of the first point
    raise_probability: float = 0.9  # of the rule on the limit: from it on the last points count by themselves
    calibration: Annotated[
        LevelCalibration | None,
        Served("What measured profiles say of level and scale; null without one. `points` are as estimated."),
    ] = None

    @property
    def head(self) -> JsonValue:
        """What is read of many trends: the time within which the step is; None where there is none."""
        return None if self.step is None else [self.step.before_ns, self.step.after_ns]


TREND = ResultKind("trend", SubjectKind.WHEELSET, WearTrend, one_in_force=True)
"""Trends of wheelsets; their parts are baselines, their heads the times before and behind the newest step."""


def baseline_part(baseline: int) -> str:
    """Return the part of a baseline."""
    return f"{baseline:04d}"


@dataclass(frozen=True, slots=True)
class TrendRecord:
    """A trend as refreshed at ``recorded_ns``."""

    wheelset: str
    baseline: int
    trend: WearTrend
    input_digest: str
    code_version: str
    recorded_ns: int
    parameters: Annotated[Mapping[str, JsonValue], Served("Settings that shaped it; empty where none were kept.")] = (
        field(default_factory=dict)
    )


@dataclass(frozen=True, slots=True)
class SuspensionFinding:
    """Yaw stiffness over longitudinal creep coefficient of a vehicle, by one section in one epoch, over ``assumed``."""

    vehicle: str
    section: str
    from_ns: int  # begin of the first window
    to_ns: int  # end of the last
    ratio: float
    ratio_std: float
    assumed: Annotated[
        float, Served("Yaw stiffness over longitudinal creep coefficient of the vehicle's class.", "assumed_m")
    ]
    code_version: str
    recorded_ns: int = field(metadata={"made_from": False})

    @property
    def stiffness_ratio(
        self,
    ) -> Annotated[Estimate, Served("Relative to the assumed one; it moves with the creep too.", "stiffness_ratio_1")]:
        """The ratio with its interval."""
        return with_interval(self.ratio, self.ratio_std)


@dataclass(frozen=True, slots=True)
class SuspensionChange:
    """By how much the ratio of a vehicle has changed against its own past and the other vehicles."""

    vehicle: str
    change: float  # relative: -0.3 is softer by 30 %, or of 43 % more creep coefficient
    std: float
    past: Annotated[int, Served("Findings before the change.", "past_findings")]
    recent: Annotated[int, Served("Findings since the change.", "recent_findings")]
    others: Annotated[
        int, Served("Vehicles on the same sections at the same time, which show friction.", "other_vehicles")
    ]
    recent_ns: Annotated[int, Served("", "measured_to")]  # end of the newest
    step_probability: float | None = None  # of a sudden change, which the recent ones are behind; None without one
    since_ns: int | None = None  # begin of the first finding behind it

    @property
    def estimate(self) -> Annotated[Estimate, Served("Relative; -0.3 is softer by 30 %.", "change_1")]:
        """The change with its interval."""
        return with_interval(self.change, self.std, count=float(self.recent))


@dataclass(frozen=True, slots=True)
class SuspensionShown:
    """What all passes of a vehicle show: the newest change, and whether an alert stands and since when."""

    newest: SuspensionChange | None  # None where too few findings are known
    stands: bool
    since_ns: int | None = None


SUSPENSION = ResultKind("suspension", SubjectKind.VEHICLE, SuspensionShown, History.NEWEST)


class StepCause(StrEnum):
    """What happened to a wheelset or to its sensor."""

    TURNED = "turned"  # reprofiled
    EXCHANGED = "exchanged"  # for another wheelset
    TURNED_END_FOR_END = "turned_end_for_end"  # left wheel on the other side
    DAMAGED = "damaged"
    SENSOR = "sensor"  # of another scale, or exchanged


@dataclass(frozen=True, slots=True)
class StepExplanation:
    """How well a cause explains a step: share of all causes, and the standard deviations that it leaves open."""

    cause: StepCause
    share: float
    left: float


IDENTITY = "identity"  # kind of the alerts that record a change
UNREGISTERED_CHANGE = "unregistered_change"  # kind of the alerts of steps of a trend
BEFORE, AFTER = "before_ns", "after_ns"  # in their evidence


class _Dated(Protocol):
    @property
    def from_ns(self) -> int: ...


_Record = TypeVar("_Record", bound=_Dated)


@dataclass(frozen=True, slots=True)
class IdentityChange:
    """The time within which the wheelset changed; what was recorded within it is of neither."""

    before_ns: int  # end of the data before
    after_ns: int  # begin of the data after


def latest_identity_change(alerts: Iterable[Alert]) -> IdentityChange | None:
    """Return the last change; None where there is none."""
    changes = [_change(alert) for alert in alerts if alert.kind == IDENTITY]
    return max((change for change in changes if change is not None), key=lambda change: change.after_ns, default=None)


def since_change(records: Sequence[_Record], change: IdentityChange | None) -> list[_Record]:
    """Return the geometries of the wheelset that it is now."""
    return [record for record in records if change is None or record.from_ns >= change.after_ns]


def _change(alert: Alert) -> IdentityChange | None:
    before, after = alert.evidence.get(BEFORE), alert.evidence.get(AFTER)
    return IdentityChange(before, after) if isinstance(before, int) and isinstance(after, int) else None


def on_one_side(change: IdentityChange | None, first_ns: int, second_ns: int) -> bool:
    """Return whether two times are of the same wheelset: both before its identity change, or both after it."""
    if change is None:
        return True
    before = first_ns <= change.before_ns and second_ns <= change.before_ns
    return before or (first_ns >= change.after_ns and second_ns >= change.after_ns)


@dataclass(frozen=True, slots=True)
class StepSurroundings:
    """What else is known about the time of a step."""

    behind: tuple[KnownConicity, ...] = ()  # of the newest interval behind it
    designed: Mapping[float, float] | None = None  # conicity of the wheel as designed by amplitude (m)
    others: Sequence[TrendStep | None] = ()  # newest of the other wheelsets of the vehicle; None of one without
