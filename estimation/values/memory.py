"""What is kept in memory or worked on at once; no number of a result depends on it."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class MemoryLimits:
    """How much is kept in memory or worked on at once."""

    adhesion_filters: int = 32  # filters
    profile_curves: int = 64  # of a pair of profiles, worn
    damper_filters: int = 8  # classes
    sharpening_operators: int = 64  # the bins and blurs of wheelsets are much alike
    alignment_splines: int = 256  # 16 kB each
    deconvolved_tracks: int = 16  # every window of a section needs its alignment
    wheelset_keys: int = 256  # wheelsets whose keys are kept
    extrapolations: int = 20_000  # of intervals, which do not change
    trends: int = 10_000  # of earlier intervals, which do not change: a fit costs some 10 ms
    covariance_rows: int = 5_000
    segment_lengths: int = 8  # of segments, whose functions are kept: most windows are whole
    spline_points: int = 512  # of an alignment, in a piece


MEMORY = MemoryLimits()
