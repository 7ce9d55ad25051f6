"""One window to its bin table, or the reason why not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from estimation.motion.checks import (
    check_axis_signs,
    check_moving,
    describe_jumps,
    direction,
    position_jumps,
    to_wheelset_axes,
)
from estimation.motion.gates import WindowParameters, gate
from estimation.motion.gauge_shift import gauge_shift
from estimation.motion.parameters import Refusal
from estimation.motion.track_relative import motion
from estimation.tables import bin_table
from estimation.tables.bin_table import BinParameters
from estimation.values.geometry import BinTable
from estimation.values.track import Correction, TrackAlignment, TrackLayout
from estimation.values.windows import Window

NO_ALIGNMENT = "the alignment of the track section is not known"


def tabulate_window(
    window: Window,
    track: TrackAlignment | None,
    parameters: WindowParameters,
    correction: Correction | None = None,
    misplaced: str = "",
    *,
    mounted_reversed: bool = False,
    layout: TrackLayout | None = None,
) -> BinTable | Refusal:
    """Return the bin table of ``window`` on ``track``, or why the window is refused.

    Parameters
    ----------
    window
        Measured accelerations of one wheelset.
    track
        Alignment of its track section; None where none is on file, all NaN where that is of the gauge alone.
    parameters
        Gates, filters and bins.
    correction
        From the measured positions to the true ones; None where they are believed.
    misplaced
        Why the position is not certain; empty where it is.
    mounted_reversed
        The wheelset's left wheel is on the vehicle's right-hand side.
    layout
        Curves of the section, which are left out; None where none is on file.
    """
    refused = gate(window.quality, window.track_section, parameters.gates)
    if refused is not None:
        return refused
    if track is None or not np.isfinite(track.alignment).any():
        return Refusal(NO_ALIGNMENT)
    if misplaced:
        return Refusal(misplaced)
    refused = _against(window, parameters)
    if refused is not None:
        return refused
    window, track = to_wheelset_axes(window, track, direction(window), mounted_reversed=mounted_reversed)
    if correction is not None:
        window = replace(window, distance=correction.at(window.distance))
    shift = gauge_shift(window, track, parameters.vehicle, parameters.signals)
    moved = motion(window, track, parameters.signals, layout, shift)
    if isinstance(moved, Refusal):
        return moved
    table = bin_table.tabulate(moved, bin_parameters(parameters))
    return table if table.samples else Refusal("no sample inside the bins")


def _against(window: Window, parameters: WindowParameters) -> Refusal | None:
    """Return what a window says against itself; None where nothing."""
    reason = check_moving(window, parameters.signals)
    if not reason and direction(window) == 0:
        reason = "the vehicle runs both ways along the section"
    reason = reason or "; ".join(describe_jumps(position_jumps(window, parameters.signals)))
    reason = reason or check_axis_signs(window, parameters.signals)
    return Refusal(reason) if reason else None


def bin_parameters(parameters: WindowParameters) -> BinParameters:
    """Return the parameters of the bin tables that :func:`tabulate_window` makes: of band-limited motion."""
    return BinParameters(source=parameters.signals.source, band_limited=True, vehicle=parameters.vehicle)
