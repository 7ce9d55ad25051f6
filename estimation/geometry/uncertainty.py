"""What is not known of the vehicle and of the track, as standard deviations of a geometry."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from estimation.values.arrays import FloatArray
from estimation.values.track import RECORDED, TrackAlignment, TrackFindings

JUMP_SHARE_UNCORRECTED = 0.5  # of the gauge's own std: contact jumps move by half the gauge deviation

JUMP_SHARE_CORRECTED = 0.22  # the same where what the gauge does to the wheelset is taken off: it is known so well

JUMP_SHARE_GAUGE_ESTIMATED = 0.32  # the same where the gauge had to be found too


@dataclass(frozen=True, slots=True)
class ParameterUncertainty:
    """Relative standard deviation of the assumed parameters of the vehicle; zero for a simulation's own truth.

    The defaults read +-20 % of the creep coefficients, +-10 % of the springs and +-5 % of the masses as 95 % limits.
    ``ratio``, where it has been estimated, is that of yaw stiffness over longitudinal creep coefficient; it then
    replaces both in the yaw equation.
    """

    creep: float = 0.10
    stiffness: float = 0.05
    mass: float = 0.025
    ratio: float | None = None
    displacement: float = 0.0  # of a common scale error of y - d that the alignment leaves open
    jump_position_std: float = 0.0  # m, of where contact jumps are on a gauge that varies

    def on(self, tracks: Iterable[TrackAlignment], wheelset: str | None = None) -> ParameterUncertainty:
        """Return what is left unknown of a geometry that rests on these alignments.

        Parameters
        ----------
        tracks
            Alignments that its windows were estimated with.
        wheelset
            Its serial; where left out, the findings of an alignment count for any.
        """
        used = list(tracks)
        findings = [_findings_for(track, wheelset) for track in used]
        ratio_stds = [item.stiffness_ratio_std for item in findings if item is not None]
        return replace(
            self,
            ratio=max(ratio_stds) if ratio_stds and len(ratio_stds) == len(used) else self.ratio,
            displacement=max((track.scale_std for track in used), default=self.displacement),
            jump_position_std=max(
                (_jump_position_std(track, wheelset) for track in used), default=self.jump_position_std
            ),
        )

    def lateral(self) -> FloatArray:
        """(6,) relative stds in the order of LATERAL_TARGETS after z1."""
        return np.array([self.creep, self.creep, self.mass, self.mass, self.stiffness, self.stiffness])

    def yaw(self) -> FloatArray:
        """(4,) relative stds in the order of YAW_TARGETS after z2."""
        if self.ratio is not None:
            return np.array([0.0, self.ratio, self.mass, self.creep])
        return np.array([self.creep, self.stiffness, self.mass, self.creep])


def _findings_for(track: TrackAlignment, wheelset: str | None) -> TrackFindings | None:
    """Return what has been found on ``track``; windows on a recording do not wait for findings of their wheelset."""
    if track.findings is None or wheelset is None or track.source != RECORDED:
        return track.findings
    return track.findings if wheelset in track.findings.gauge_shifts else None


def _jump_position_std(track: TrackAlignment, wheelset: str | None) -> float:
    """Return the std, m, of where contact jumps are on the gauge of ``track``: until its effect is known, all of it."""
    shifts = {} if track.findings is None else track.findings.gauge_shifts
    taken_off = bool(shifts) if wheelset is None else wheelset in shifts
    share = (
        JUMP_SHARE_UNCORRECTED
        if not taken_off
        else JUMP_SHARE_CORRECTED
        if track.gauge_known
        else JUMP_SHARE_GAUGE_ESTIMATED
    )
    return share * float(np.std(track.gauge_deviation))
