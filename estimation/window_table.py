"""One window to its bin table, or the reason why not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from estimation import bins
from estimation.gauge_shift import gauge_shift
from estimation.settings import EstimationSettings
from estimation.signals import Refusal, motion
from estimation.track.positions import Correction
from estimation.types import BinTable, TrackAlignment, TrackLayout, Window, WindowQuality
from estimation.window_checks import (
    against_its_axes,
    as_the_wheelset_sees,
    direction,
    position_jumps,
    told,
    unmoved,
)

NO_ALIGNMENT = "the alignment of the track section is not known"


def tabulate_window(
    window: Window,
    track: TrackAlignment | None,
    settings: EstimationSettings,
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
    settings
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
    refused = gate(window.quality, window.track_section, settings)
    if refused is not None:
        return refused
    if track is None or not np.isfinite(track.alignment).any():
        return Refusal(NO_ALIGNMENT)
    if misplaced:
        return Refusal(misplaced)
    refused = _against(window, settings)
    if refused is not None:
        return refused
    window, track = as_the_wheelset_sees(window, track, direction(window), mounted_reversed=mounted_reversed)
    if correction is not None:
        window = replace(window, distance=correction.at(window.distance))
    shift = gauge_shift(window, track, settings.vehicle, settings.signals)
    moved = motion(window, track, settings.signals, layout, shift)
    if isinstance(moved, Refusal):
        return moved
    table = bins.tabulate(moved, settings.bins)
    return table if table.samples else Refusal("no sample inside the bins")


def _against(window: Window, settings: EstimationSettings) -> Refusal | None:
    """Return what a window says against itself; None where nothing."""
    reason = unmoved(window, settings.signals)
    if not reason and direction(window) == 0:
        reason = "the vehicle runs both ways along the section"
    reason = reason or "; ".join(told(position_jumps(window, settings.signals)))
    reason = reason or against_its_axes(window, settings.signals)
    return Refusal(reason) if reason else None


def gate(quality: WindowQuality, track_section: str | None, settings: EstimationSettings) -> Refusal | None:
    """Return why a window of this quality is not looked at; None where it is."""
    gates = settings.gates
    if quality.sensor_fault:
        return Refusal("the sensor reports a fault")
    if quality.coverage < gates.least_coverage:
        return Refusal(f"{quality.coverage:.0%} of the samples, {gates.least_coverage:.0%} are needed")
    if quality.clipped > gates.most_clipped:
        return Refusal(f"{quality.clipped:.1%} of the samples are clipped, at most {gates.most_clipped:.0%} may be")
    if track_section is None:
        return Refusal("the track section is not known")
    if quality.position_quality < gates.least_position_quality:
        return Refusal("the position is not known well enough")
    return None
