"""What windows say of the lateral damper of a running gear, and what they say together."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from estimation.values.arrays import FloatArray, FrozenArrays
from estimation.values.quantities import Estimate
from estimation.values.reasons import Reason
from estimation.values.results import History, ResultKind
from estimation.values.runs import SubjectKind
from estimation.values.served import Served

SHARES = (0.0, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.65, 0.8, 1.0, 1.2, 1.5, 2.0)
"""Particles: shares of the damping on file at which sums are kept; between them innovations are interpolated."""

GEAR = tuple[str, int]  # a running gear: code of its vehicle, and its first axle, from 1


@dataclass(frozen=True, slots=True)
class DamperSums(FrozenArrays):
    """Products of the innovations of q particles, summed over the samples of a window; they add up in any order.

    Of a particle there are m signals: its innovations, by how much each of k uncertain parameters changes them (one
    standard deviation of its class), the second order of that for the first p of them, and by how much they differ from
    those of the next particle. All are over the rms of what the best particle does not explain, so that windows count
    by what is known in them.
    """

    products: Annotated[FloatArray, len(SHARES) - 1, "m", "m"]
    samples: float  # independent ones
    curved: int  # p


@dataclass(frozen=True, slots=True)
class WindowDamper:
    """What one window says of the damper of a running gear."""

    vehicle: str
    first_axle: int
    wheelset: str  # of the first axle
    start_ns: int
    odometer_km: float  # of the vehicle
    content_digest: str  # of the samples of that wheelset
    class_digest: str  # of the class that it was judged by: sums of another one do not add up with these
    mass_std: float  # relative, of the mass above the wheelsets on file. Accelerations show damping over mass
    innovation: float | None = None  # mean square over the largest that is believed; None without a filter
    sums: DamperSums | None = None  # None with ``reason``
    reason: Reason | None = None

    @property
    def gear(self) -> GEAR:
        """Vehicle and first axle."""
        return self.vehicle, self.first_axle


@dataclass(frozen=True, slots=True)
class GearDamper:
    """The damper of a running gear, from its newest windows; ``windows`` say something of it."""

    vehicle: str
    first_axle: Annotated[int, Served("First axle of the running gear, from 1.")]
    share: Annotated[
        Estimate,
        Served(
            "Damping over that of the vehicle class on file; `n_windows` counts those that show it.", "damping_share_1"
        ),
    ]
    weak_probability: Annotated[
        float | None, Served("That less than half of it is left; null where unknown.", "weak_probability_1")
    ]
    weak: Annotated[bool | None, Served("Whether less than half of the damping is likely left; null where unknown.")]
    windows: int
    diverged: Annotated[int, Served("Windows that the filter did not follow.", "diverged_windows")]
    refused: Annotated[int, Served("Windows that say nothing of the damper.", "refused_windows")]
    from_ns: Annotated[int, Served("Start of the first window that counts.")]
    to_ns: Annotated[int, Served("Start of the last window that counts.")]
    from_km: Annotated[float, Served("Odometer of the vehicle at the first window.", "odometer_from_km")]
    to_km: Annotated[float, Served("Odometer of the vehicle at the last window.", "odometer_to_km")]


GEAR_DAMPERS = ResultKind("damper", SubjectKind.VEHICLE, GearDamper, History.NEWEST)


def part_of_gear(first_axle: int) -> str:
    """Return the part of the results of a vehicle that a running gear is."""
    return f"{first_axle:04d}"
