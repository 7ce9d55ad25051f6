"""What the passes of a section show of the suspension of a vehicle, over time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from estimation.values.intervals import with_interval
from estimation.values.quantities import Estimate
from estimation.values.served import Served


@dataclass(frozen=True, slots=True)
class SuspensionFinding:
    """Yaw stiffness over longitudinal creep coefficient of a vehicle, from its passes of one section in one epoch.

    ``ratio`` is relative to ``assumed``, that of the vehicle's parameters at the time. Key: (vehicle, section, to_ns).
    """

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
    recorded_ns: int

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
    past: Annotated[int, Served("", "past_findings")]  # findings
    recent: Annotated[int, Served("", "recent_findings")]
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
