"""Wear trends."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from estimation.values.arrays import FloatArray, IntArray, frozen_array
from estimation.values.json_value import JsonValue
from estimation.values.quantities import Estimate, Forecast, Status
from estimation.values.quarantine import SubjectKind
from estimation.values.reasons import Reason
from estimation.values.results import ResultKind


@dataclass(frozen=True, slots=True)
class TrendStep:
    """A sudden change of the indicator that wear does not explain; what was recorded within it is of neither side."""

    before_km: float  # mileage of the last interval before
    after_km: float  # mileage of the first interval behind
    before_ns: int  # end of the last data before
    after_ns: int  # begin of the first data behind
    found_ns: int  # end of the data that showed it first
    size: Estimate  # at ``amplitude``
    level_before: float
    amplitude: float  # m
    probability: float
    before: int  # intervals
    behind: int  # intervals


@dataclass(frozen=True, slots=True)
class WearTrend:
    """An indicator since the last reprofiling or step, its robust slope, and when it reaches its limit."""

    quantity: str  # "equivalent_conicity"
    mileage_km: FloatArray  # (k,) since the wheelset was new
    measured_ns: IntArray  # (k,)
    value: FloatArray  # (k,)
    std: FloatArray  # (k,)
    slope_per_1000_km: Estimate
    slope_per_year: Estimate
    fitted: Estimate  # value of the fitted curve at the last point
    limit: float
    distance_to_limit_km: Forecast  # from the last point; 0 where already reached
    date_of_limit_ns: Forecast
    probability_over_limit: float | None  # now
    status: Status
    reason: Reason | None = None
    converged: bool = True  # whether the robust fits over distance and date stopped changing
    not_comparable: Reason | None = None  # why the limit is not held against it; None where it is
    step: TrendStep | None = None  # that its points are behind
    few_behind: Reason | None = None  # why nothing is forecast: too few points behind the step; None where enough are

    def __post_init__(self) -> None:
        k = len(self.value)
        for name in ("mileage_km", "value", "std"):
            object.__setattr__(self, name, frozen_array(getattr(self, name), (k,), name=name))
        object.__setattr__(self, "measured_ns", frozen_array(self.measured_ns, (k,), np.int64, name="measured_ns"))

    @property
    def head(self) -> JsonValue:
        """What is read of many trends: the time within which the step is; None where there is none."""
        return None if self.step is None else [self.step.before_ns, self.step.after_ns]


TREND = ResultKind("trend", SubjectKind.WHEELSET, WearTrend, one_in_force=True)
"""Trends of wheelsets; their parts are baselines."""


@dataclass(frozen=True, slots=True)
class TrendRecord:
    """A trend as refreshed at ``recorded_ns``."""

    wheelset: str
    baseline: int
    trend: WearTrend
    input_digest: str
    code_version: str
    recorded_ns: int
    parameters: Mapping[str, JsonValue] = field(default_factory=dict)  # that shaped it
