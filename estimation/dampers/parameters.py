"""Numbers of what windows say of dampers."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class DampingParameters:
    """Numbers of what windows say of dampers."""

    # damper
    unknown_begin_s: float = 6.0  # at the begin of a segment, whose deflections are not known
    model_error: float = 0.02  # of the acceleration above, that stiff bodies do not explain whatever their parameters
    least_excitation: float = 3.0  # what motion shows of the damper over what noise does
    fewest_samples: float = 600.0  # of a window that are counted: 10 s
    most_unexplained_share: float = 0.05  # mean square of innovations beside noise, over that of the acceleration above
    window_stride: int = 3  # windows, one of which is looked at: a damper changes over months
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
