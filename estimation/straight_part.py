"""What of a window lies on straight track, for estimates that know no track yet."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from estimation.felt_curves import felt_curve
from estimation.signals import Refusal, SignalParameters
from estimation.types import TrackLayout, Window
from estimation.usable_samples import straight


def straight_part(window: Window, layout: TrackLayout | None, parameters: SignalParameters) -> Window | Refusal:
    """Return the window with the samples in curves not valid, or why nothing is left.

    Parameters
    ----------
    window
        Samples, at positions as measured.
    layout
        Curves of the section; None where none is on file: then a window that feels a curve is refused.
    parameters
        What counts as straight.
    """
    if layout is None:
        with np.errstate(invalid="ignore"):
            running = np.asarray(window.valid & (window.speed >= parameters.least_speed_m_s))
        felt = felt_curve(window, running, parameters.most_lean)
        return Refusal(felt) if felt else window
    left = window.valid & straight(window.distance, layout, parameters.curve_limits)
    if not left.any() and window.valid.any():
        return Refusal("the window lies in curves")
    return replace(window, valid=left)
