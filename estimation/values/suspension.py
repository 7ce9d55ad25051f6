"""What the passes of a section show of the suspension of a vehicle, over time."""

from __future__ import annotations

from dataclasses import dataclass, field

from estimation.values.quarantine import SubjectKind
from estimation.values.results import History, ResultKind


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
    assumed: float  # m, k_psi / f11
    code_version: str
    recorded_ns: int = field(metadata={"made_from": False})


@dataclass(frozen=True, slots=True)
class SuspensionChange:
    """By how much the ratio of a vehicle has changed against its own past and the other vehicles."""

    vehicle: str
    change: float  # relative: -0.3 is softer by 30 %, or of 43 % more creep coefficient
    std: float
    past: int  # findings
    recent: int
    others: int  # vehicles on the same sections at the same time
    recent_ns: int  # end of the newest
    step_probability: float | None = None  # of a sudden change, which the recent ones are behind; None without one
    since_ns: int | None = None  # begin of the first finding behind it


@dataclass(frozen=True, slots=True)
class SuspensionShown:
    """What all passes of a vehicle show: the newest change, and whether an alert stands and since when."""

    newest: SuspensionChange | None  # None where too few findings are known
    stands: bool
    since_ns: int | None = None


SUSPENSION = ResultKind("suspension", SubjectKind.VEHICLE, SuspensionShown, history=History.NEWEST)
