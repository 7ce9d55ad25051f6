"""What the estimators see of a wheelset: its motion relative to the track, from ideal or from real sensors."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from estimation.values.arrays import BoolArray, FloatArray, IntArray, frozen_array

NOT_SIGNALS = frozenset({"valid", "block", "band_limited", "stiffness_ratio"})


@dataclass(frozen=True, slots=True)
class Motion:
    """Motion of one wheelset and its suspended mass over one window.

    With ``band_limited`` every lateral and angular signal has lost its wavelengths beyond the cut-off (all through the
    same filter), so that offsets carry no meaning; without, they are absolute. Samples that are not ``valid`` are
    left out. ``block`` numbers the intervals of some seconds from which standard deviations are computed; -1
    where a sample belongs to none.

    ``stiffness_ratio`` is the vehicle's yaw stiffness over creep coefficient, of the assumed one, where that has been
    estimated. Where it is known what the gauge does, ``displacement`` is that at nominal gauge.
    """

    speed: FloatArray  # (n,) V, m/s
    displacement: FloatArray  # (n,) y - d, m
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

    def __post_init__(self) -> None:
        n = len(self.valid)
        for item in fields(self):
            if item.name not in NOT_SIGNALS:
                array = frozen_array(getattr(self, item.name), (n,), name=item.name)
                object.__setattr__(self, item.name, array)
        object.__setattr__(self, "valid", frozen_array(self.valid, (n,), np.bool_, name="valid"))
        object.__setattr__(self, "block", frozen_array(self.block, (n,), np.int64, name="block"))

    def __len__(self) -> int:
        return len(self.valid)
