"""Numbers of the jobs that no deployment sets."""

from __future__ import annotations

from dataclasses import dataclass

from estimation.values.units import DAY_NS


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
    bogie_windows: int = 60  # that stand for all of a mileage interval where a bogie is estimated as one: an hour
    bogie_half_lives: float = 2.9  # back from the newest of them: as old, in the mean, as windows with forgetting
    # refresh rails
    gauge_tolerance: float = 0.3e-3  # m, within which gauges count as alike
    gauge_digits: int = 4  # of a gauge in m
    # refresh signatures
    judged_windows: int = 12  # windows that a wheelset is judged by
    # epoch inputs
    growth_factor: float = 4.0  # times the windows as computed with: an open epoch is computed though more still come
    # estimated geometry
    contradiction_span_ns: int = DAY_NS  # of the time that is looked at
    most_refused_share: float = 0.3  # of all windows: of right vehicles hardly one in a thousand is refused so
    # signature entries
    conicity_wear_per_km: float = 1e-6  # std of what wear changes a conicity by, since a signature
    # store alignment
    learnt_std_share: float = 0.7  # of the std beforehand: with more, the passes say nothing of the ratio
    # wheelset facts
    design_amplitudes: tuple[float, ...] = (1e-3, 1.5e-3, 2e-3, 2.5e-3, 3e-3)  # m, behind a step against its design


JOBS = StageParameters()


@dataclass(frozen=True, slots=True)
class WorkParameters:
    """How work is claimed, handed out and held in memory; no number of a result depends on it."""

    at_once: int = 16  # subjects of a stage that are loaded and stored in one transaction
    lease_s: float = 60.0  # of a claim, by default
    claimed_batches: int = 4  # of subjects, that are claimed together
    scheduler_check_s: float = 1.0  # whether it still is the scheduler of its database
    clock_step_ns: int = 30_000_000_000  # more or less between two checks: somebody has set the clock
    scheduler_lease_s: float = 45.0  # at most, so that another one has its place within a minute
    units_ahead: int = 2  # in hand per unit that is worked on, so that no worker waits for the next
    most_tries: int = 3  # workers that a unit is given to, one after the other, before the run fails
    stop_check_s: float = 1.0  # while units are worked on
    units_per_worker: int = 4  # into which little work is divided at least: all end at about the same time
    rolled_together: int = 32  # windows that are added again each time before their sums are written once
    sums_in_memory: int = 256  # packed sums or tables, 50 kB each
    mileages_together: int = 64  # windows looked at before it is asked whether those behind have to be, too
    loaded_windows: int = 4  # of a megabyte each: both of a bogie need both
    passes_in_memory: int = 16  # windows that are examined together
    epoch_read_factor: int = 4  # times the windows of an epoch that are read to find it
    roll_ups_in_memory: int = 4  # of a wheelset, 1.5 MB each
    fits_in_memory: int = 8  # of bogies, until the other wheelset asks for the same
    signature_windows: int = 32  # of a megabyte each, in one transaction
    windows_factor: int = 8  # times as many are read where those that were read do not reach back far enough
    creep_windows: int = 32  # of a megabyte each, in one transaction
    sums_kept_ns: int = 31 * DAY_NS  # of windows, beyond the longest span that is pooled
    windows_apart_ns: int = DAY_NS  # starts of new windows, of which those between are not read


WORK = WorkParameters()
