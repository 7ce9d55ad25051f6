"""Parameters of the estimate of dampers."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class DampingParameters:
    """Parameters of the estimate of dampers."""

    # damper
    unknown_begin_s: float = 6.0  # at the begin of a segment, where the deflections are not known yet
    model_error: float = 0.02  # of the acceleration above: rigid bodies never explain it, whatever their parameters
    least_excitation: float = 3.0  # effect of the damper in the motion over that in the noise
    fewest_samples: float = 600.0  # counted samples of a window: 10 s
    most_unexplained_share: float = 0.05  # mean square of innovations beyond noise, over that of acceleration above
    window_stride: int = 3  # one window in as many is estimated: a damper changes over months
    largest_std: float = 0.3  # relative, of parameters beside the damper: beyond it their effect is not proportional
    # damper filters
    offset_corner_hz: float = 0.3  # below it the offset of the sensors explains what they measure
    least_noise_density: float = 1e-5  # m/s2 per root hertz, of sensors that have no noise on file
    least_scale_std: float = 0.01  # of a sensor, whatever is on file
    clock_std_s: float = 1e-3  # half the difference of two nodes' times
    memory_s: float = 30.0  # after which the filters have forgotten
    # suspension equations
    pass_hz: float = 5.0
    stop_hz: float = 8.0
    stop_db: float = 70.0
    step_s: float = 0.016  # between the samples that the filters take


DAMPING = DampingParameters()
