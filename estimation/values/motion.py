"""What the estimators see of a wheelset: its motion relative to the track, from ideal or from real sensors."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import numpy as np

from estimation.values.arrays import BoolArray, FloatArray, IntArray, frozen_array

OF_FRAME = ("frame_yaw", "frame_yaw_rate", "frame_displacement")
NOT_SIGNALS = frozenset(
    {"valid", "block", "band_limited", "stiffness_ratio", "sample_interval_s", "displacement_noise", *OF_FRAME}
)


@dataclass(frozen=True, slots=True)
class Motion:
    """Motion of one wheelset and its suspended mass over one window.

    With ``band_limited`` every lateral and angular signal has lost its wavelengths beyond the cut-off (all through the
    same filter), so that offsets carry no meaning; without, they are absolute. Samples that are not ``valid`` are
    left out. ``block`` numbers the intervals of some seconds from which standard deviations are computed; -1
    where a sample belongs to none.

    ``stiffness_ratio`` is the vehicle's yaw stiffness over creep coefficient, of the assumed one, where that has been
    estimated. Where it is known what the gauge does, ``displacement`` is that at nominal gauge. The yaw spring of a
    wheelset is tied to the frame of its bogie; without one to what does not yaw.
    """

    speed: FloatArray  # (n,) V, m/s
    displacement: FloatArray  # (n,) y - d where EN 15302 means it, m: ``motion.cross_level``
    lateral_velocity: FloatArray  # (n,) y', m/s
    lateral_acceleration: FloatArray  # (n,) y'', m/s2
    yaw: FloatArray  # (n,) psi, rad
    yaw_rate: FloatArray  # (n,) psi', rad/s
    yaw_acceleration: FloatArray  # (n,) psi'', rad/s2
    roll: FloatArray  # (n,) phi, rad
    roll_rate: FloatArray  # (n,) phi', rad/s
    suspension_deflection: FloatArray  # (n,) ym - y, m
    suspension_deflection_rate: FloatArray  # (n,) ym' - y', m/s
    valid: BoolArray  # (n,)
    block: IntArray  # (n,)
    band_limited: bool
    stiffness_ratio: float = 1.0
    frame_yaw: FloatArray | None = None  # (n,) rad, of the bogie frame; None without a bogie
    frame_yaw_rate: FloatArray | None = None  # (n,) rad/s
    frame_displacement: FloatArray | None = None  # (n,) m, lateral, of the frame above the axle
    sample_interval_s: float = math.nan  # between samples; what filters over time needs it
    displacement_noise: float = 0.0  # m2, variance of ``displacement`` by the sensors; mean over the valid samples

    def __post_init__(self) -> None:
        n = len(self.valid)
        for item in fields(self):
            if item.name not in NOT_SIGNALS:
                array = frozen_array(getattr(self, item.name), (n,), name=item.name)
                object.__setattr__(self, item.name, array)
        for name in OF_FRAME:
            if getattr(self, name) is not None:
                object.__setattr__(self, name, frozen_array(getattr(self, name), (n,), name=name))
        object.__setattr__(self, "valid", frozen_array(self.valid, (n,), np.bool_, name="valid"))
        object.__setattr__(self, "block", frozen_array(self.block, (n,), np.int64, name="block"))

    def __len__(self) -> int:
        return len(self.valid)

    @property
    def yaw_deflection(self) -> FloatArray:
        """Angle (n,) of the yaw spring, rad: yaw less that of the frame."""
        return self.yaw if self.frame_yaw is None else self.yaw - self.frame_yaw

    @property
    def yaw_deflection_rate(self) -> FloatArray:
        """Rate (n,) of that angle, rad/s."""
        return self.yaw_rate if self.frame_yaw_rate is None else self.yaw_rate - self.frame_yaw_rate
