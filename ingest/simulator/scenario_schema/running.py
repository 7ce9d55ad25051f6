"""When and how fast the vehicles run: speeds and campaigns."""

from __future__ import annotations

import math
from datetime import datetime
from typing import Annotated, Self

from pydantic import AfterValidator, Field, model_validator

from ingest.input_file import InputTable, NotNegative, Positive, field_error
from ingest.simulator.motion import MINIMUM_SPEED
from ingest.simulator.scenario import Sessions, SpeedRange
from ingest.simulator.scenario_schema.units import KM


def _with_offset(moment: datetime) -> datetime:
    if moment.tzinfo is None:
        raise field_error("needs an offset from UTC, as in 2024-01-08T05:30:00Z")
    return moment


Moment = Annotated[datetime, AfterValidator(_with_offset)]


class SpeedTable(InputTable):
    """``[speed]``."""

    lowest_m_s: float = Field(ge=2.0 * MINIMUM_SPEED)
    highest_m_s: float = Field(le=131.0)
    period_s: float = Field(default=120.0, ge=20.0)
    stop_every_s: NotNegative = 0.0
    stop_s: NotNegative = 30.0
    braking_m_s2: float = Field(default=0.5, gt=0.0, le=2.0)
    steady: bool = False

    @model_validator(mode="after")
    def _check_order(self) -> Self:
        if self.highest_m_s < self.lowest_m_s:
            raise field_error(f"{self.highest_m_s} is outside the range: at least {self.lowest_m_s:g}", "highest_m_s")
        return self

    def plan(self) -> SpeedRange:
        """Return the range of speeds, m/s."""
        return SpeedRange(
            lowest=self.lowest_m_s,
            highest=self.highest_m_s,
            period=self.period_s,
            steady=self.steady,
            stop_every=self.stop_every_s,
            stop=self.stop_s,
            braking=self.braking_m_s2,
        )


class SessionsTable(InputTable):
    """``[sessions]``."""

    start: Moment
    campaigns: int = Field(ge=1, le=10_000)
    minutes_each: float | None = Field(default=None, gt=0.0, le=600.0)
    push_pull: bool = False
    whole_section: bool = False
    km_between: Positive
    first_odometer_km: NotNegative = 0.0
    km_per_day: Positive = 400.0
    start_within_m: NotNegative | None = None

    @model_validator(mode="after")
    def _check_length_of_runs(self) -> Self:
        if self.minutes_each is None and not self.whole_section:
            raise field_error("is missing", "minutes_each")
        for key in ("minutes_each", "start_within_m"):
            if self.whole_section and key in self.model_fields_set:
                raise field_error("cannot be given beside whole_section = true", key)
        return self

    def plan(self, longest_s: float) -> Sessions:
        """Return the campaigns in SI units, times in ns of the vehicle clock.

        Args:
            longest_s: How long a run over the whole section takes at most, s.
        """
        return Sessions(
            start_ns=round(self.start.timestamp()) * 1_000_000_000,
            campaigns=self.campaigns,
            duration=longest_s if self.minutes_each is None else 60.0 * self.minutes_each,
            push_pull=self.push_pull,
            whole_section=self.whole_section,
            distance_between=KM * self.km_between,
            first_odometer=KM * self.first_odometer_km,
            distance_per_day=KM * self.km_per_day,
            start_within=math.inf if self.start_within_m is None else self.start_within_m,
        )
