"""Numbers of the jobs that no deployment sets."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class StageParameters:
    """Numbers of the jobs that no deployment sets."""

    # compare identities
    intervals_before_change: int = 8  # intervals before the first that has changed: with these it is compared
    intervals_read: tuple[int, int] = (16, 64)  # before it, at first and where too few of them are usable
    # refresh adhesion
    most_pooled_spans: int = 8  # of a section that are pooled in one look: the next run goes on
    most_gear_windows: int = 600  # of a running gear that count and are kept: 10 hours of running
    # refresh geometry
    remembered_half_lives: float = 20.0  # a weight of one in a million
    # refresh rails
    gauge_tolerance: float = 0.3e-3  # m, within which gauges count as alike
    gauge_digits: int = 4  # of a gauge in m
    # refresh signatures
    judged_windows: int = 12  # windows that a wheelset is judged by
    # epoch inputs
    growth_factor: float = 4.0  # times the windows as computed with: an open epoch is computed though more still come
    # estimated geometry
    contradiction_span_ns: int = 24 * 3600 * 10**9  # of the time that is looked at
    most_refused_share: float = 0.3  # of all windows: of right vehicles hardly one in a thousand is refused so
    # signature entries
    conicity_wear_per_km: float = 1e-6  # std of what wear changes a conicity by, since a signature
    # store alignment
    learnt_std_share: float = 0.7  # of the std beforehand: with more, the passes say nothing of the ratio
    # wheelset facts
    design_amplitudes: tuple[float, ...] = (1e-3, 1.5e-3, 2e-3, 2.5e-3, 3e-3)  # m, behind a step against its design


JOBS = StageParameters()
