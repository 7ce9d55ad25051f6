"""What an estimator is told of the track: a known alignment, the one that the fleet has found, or nothing.

The alignment from the fleet is ``estimation.track.section.estimate_section``; windows are put where it says they were.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from estimation.motion.gates import WindowParameters
from estimation.motion.gauge_shift import gauge_shift
from estimation.motion.joined_windows import whole_runs
from estimation.motion.track_relative import motion
from estimation.track.epochs import resampled
from estimation.track.panel.measured_curves import MeasuredCurve
from estimation.track.passes import Pass, passes
from estimation.track.section import SectionEstimate, estimate_section
from estimation.track.settings import AlignmentSettings
from estimation.values.motion import Motion
from estimation.values.quantities import Status
from estimation.values.reasons import Reason
from estimation.values.track import Correction, TrackAlignment
from estimation.values.windows import Window

STEP = 0.5  # m
_UNMOVED = Correction()


@dataclass(frozen=True, slots=True)
class TrackKnowledge:
    """An alignment, and where the windows were; without ``found`` their positions are believed."""

    track: TrackAlignment
    found: SectionEstimate | None = None

    def placed(self, window: Window) -> Window | None:
        """Return ``window`` where it was; None where its journey agrees with nothing."""
        if self.found is None:
            return window
        correction = self._correction(window)
        return None if correction is None else replace(window, distance=correction.at(window.distance))

    def correction_of(self, window: Window) -> Correction | None:
        """Return how the positions of ``window`` are put right; None where its journey agrees with nothing."""
        return _UNMOVED if self.found is None else self._correction(window)

    def _correction(self, window: Window) -> Correction | None:
        assert self.found is not None
        began = [
            journey.from_ns
            for journey in self.found.report.journeys
            if journey.vehicle == window.vehicle and journey.from_ns <= window.start_ns
        ]
        return self.found.corrections.get((window.vehicle, max(began))) if began else None


def straight_track(section: str, length: float) -> TrackAlignment:
    """Return what someone takes the section for who knows nothing of it: no alignment at all, d = 0."""
    s = np.asarray(np.arange(round(length / STEP) + 1) * STEP, dtype=np.float64)
    zero = np.zeros(len(s))
    return TrackAlignment(section, 0, s, zero, zero, zero, zero, zero.astype(np.int64), Status.ESTIMATED)


def section_passes(windows: Iterable[Window], parameters: WindowParameters, alignment: AlignmentSettings) -> list[Pass]:
    """Return the passes of ``windows``, as the alignment of their section is found from them."""
    return [
        resampled(item, item.wheelset, alignment.pass_step)
        for window in whole_runs(windows)
        for item in passes(window, parameters.vehicle, parameters.signals)
    ]


def fleet_knowledge(
    found: Sequence[Pass],
    evidence: TrackAlignment | None,
    section: str,
    length: float,
    settings: AlignmentSettings,
    measured: Mapping[str, MeasuredCurve] | None = None,
) -> TrackKnowledge | str:
    """Return the alignment that ``found`` and ``evidence`` give, and the positions; or why there is none.

    Parameters
    ----------
    found
        Passes of the section.
    evidence
        What is known beforehand: the alignment, or, where that is all NaN, the gauge alone.
    section, length
        Its code, and its length, m.
    settings
        Of the alignment.
    measured
        What measured profiles say, by wheelset.
    """
    panel = replace(settings.section.panel, length=length)
    parameters = replace(settings.section, panel=panel)
    estimate = estimate_section(section, found, evidence, parameters, measured)
    if estimate.alignment is None:
        return str(estimate.report.reason)
    return TrackKnowledge(estimate.alignment, estimate)


def motions(windows: Iterable[Window], knowledge: TrackKnowledge, parameters: WindowParameters) -> Iterator[Motion]:
    """Yield the motion of every window relative to the track, as far as it is known; refused windows are left out."""
    for window in windows:
        placed = knowledge.placed(window)
        if placed is None:
            continue
        shift = gauge_shift(placed, knowledge.track, parameters.vehicle, parameters.signals)
        moved = motion(placed, knowledge.track, parameters.signals, gauge_shift=shift)
        if not isinstance(moved, Reason):
            yield moved
