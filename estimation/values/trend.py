"""Wear trends."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated

import numpy as np

from estimation.values.arrays import FloatArray, IntArray, frozen_array
from estimation.values.json_value import JsonValue
from estimation.values.quantities import Estimate, Forecast, Status
from estimation.values.reasons import Reason
from estimation.values.served import MM, Served


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
    amplitude: Annotated[float, Served("Amplitude that size and level are of.", "amplitude_mm", MM, finite=False)]
    probability: Annotated[float, Served("That there is a step there.", "probability_1", finite=False)]
    before: Annotated[int, Served("Intervals before it.", "intervals_before")]
    behind: Annotated[int, Served("Intervals behind it.", "intervals_behind")]


@dataclass(frozen=True, slots=True)
class WearTrend:
    """An indicator since the last reprofiling or step, its robust slope, and when it reaches its limit."""

    quantity: Annotated[str, Served(example="equivalent_conicity")]  # "equivalent_conicity"
    mileage_km: FloatArray  # (k,) since the wheelset was new
    measured_ns: Annotated[IntArray, Served(name="measured_at")]  # (k,)
    value: Annotated[FloatArray, Served(name="value_1")]  # (k,)
    std: Annotated[FloatArray, Served(name="std_1")]  # (k,)
    slope_per_1000_km: Annotated[Estimate, Served(name="slope_1_per_1000_km")]
    slope_per_year: Annotated[Estimate, Served(name="slope_1_per_year")]
    fitted: Annotated[Estimate, Served("The fitted curve at the last point, at the mileage of that point.", "fitted_1")]
    limit: Annotated[float, Served(name="limit_1", finite=False)]
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

    def __post_init__(self) -> None:
        k = len(self.value)
        for name in ("mileage_km", "value", "std"):
            object.__setattr__(self, name, frozen_array(getattr(self, name), (k,), name=name))
        object.__setattr__(self, "measured_ns", frozen_array(self.measured_ns, (k,), np.int64, name="measured_ns"))


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
