"""One window to its bin table, or the reason why not."""

from __future__ import annotations

from estimation.motion.gates import WindowParameters
from estimation.motion.window_motion import window_motion
from estimation.tables import bin_table
from estimation.tables.bin_table import BinParameters
from estimation.values.geometry import BinTable
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.track import Correction, TrackAlignment, TrackLayout
from estimation.values.windows import Window


def tabulate_window(
    window: Window,
    track: TrackAlignment | None,
    parameters: WindowParameters,
    correction: Correction | None = None,
    misplaced: Reason | None = None,
    *,
    mounted_reversed: bool = False,
    layout: TrackLayout | None = None,
) -> BinTable | Reason:
    """Return the bin table of ``window`` on ``track``, or why the window is refused.

    Parameters
    ----------
    window, track, parameters, correction, misplaced, mounted_reversed, layout
        As :func:`~estimation.motion.window_motion.window_motion` takes them.
    """
    moved = window_motion(
        window, track, parameters, correction, misplaced, mounted_reversed=mounted_reversed, layout=layout
    )
    if isinstance(moved, Reason):
        return moved
    table = bin_table.tabulate(moved, bin_parameters(parameters))
    return table if table.samples else Reason(ReasonCode.OUTSIDE_BINS, "no sample is inside the bins")


def bin_parameters(parameters: WindowParameters) -> BinParameters:
    """Return the parameters of the bin tables that :func:`tabulate_window` makes: of band-limited motion.

    Parameters
    ----------
    parameters
        Vehicle and filters, which go into the key of the tables.
    """
    return BinParameters(source=parameters.signals.source, band_limited=True, vehicle=parameters.vehicle)
