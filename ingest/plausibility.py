"""What a vehicle says of its clock, motion and place that can be believed."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from estimation.values.arrays import BoolArray, FloatArray, IntArray
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.track import SectionLine
from estimation.values.units import DAY_NS, SECOND_NS

EARLIEST_NS = 946_684_800 * SECOND_NS
"""2000-01-01: a clock that shows less has not been set since it was switched on (CANopen's begins in 1984)."""

LATEST_NS = 4_102_444_800 * SECOND_NS  # 2100-01-01
FEWEST_ALIKE = 3  # TIME frames in a row that agree and are a clock; fewer among others are odd ones
LONGEST_SPAN_NS = 31 * DAY_NS  # from the first to the last frame of one recording
MOST_AHEAD_NS = DAY_NS  # how far the vehicle's clock may be ahead of our time of receipt
OUR_CLOCK_SET_NS = 1_577_836_800 * SECOND_NS
"""2020-01-01: a receipt that says less was given while our own clock was not set, and shows nothing."""


def possible(vehicle_ns: IntArray) -> BoolArray:
    """Return which vehicle times (n,), ns UTC, are those of a clock that was set."""
    return np.asarray((vehicle_ns >= EARLIEST_NS) & (vehicle_ns < LATEST_NS))


def runs_alike(t_ns: IntArray, vehicle_ns: IntArray, tolerance_ns: int) -> list[tuple[int, int]]:
    """Return the runs ``[first, behind)`` of TIME frames, by increasing stamp, that agree with the one before."""
    if len(t_ns) == 0:
        return []
    edges = np.flatnonzero(np.abs(np.diff(vehicle_ns - t_ns)) > tolerance_ns) + 1
    ends = [0, *edges.tolist(), len(t_ns)]
    return list(pairwise(ends))


def without_odd_ones(t_ns: IntArray, vehicle_ns: IntArray, tolerance_ns: int) -> BoolArray:
    """Return which TIME frames (n,) count: all but a few odd ones between two runs that agree with each other.

    Where the vehicle's clock was set the runs on both sides disagree, and all of their frames count.
    """
    kept = np.ones(len(t_ns), dtype=np.bool_)
    offset = vehicle_ns - t_ns
    before: int | None = None  # last frame of the last run that is a clock
    for first, behind in runs_alike(t_ns, vehicle_ns, tolerance_ns):
        if behind - first < FEWEST_ALIKE:
            continue
        if before is not None and abs(int(offset[first] - offset[before])) <= tolerance_ns:
            kept[before + 1 : first] = False
        before = behind - 1
    return kept


def believed(t_ns: IntArray, vehicle_ns: IntArray, tolerance_ns: int) -> BoolArray:
    """Return which TIME frames (n,) show where a recording is: those of runs; all where there is no run."""
    credible = np.zeros(len(t_ns), dtype=np.bool_)
    for first, behind in runs_alike(t_ns, vehicle_ns, tolerance_ns):
        credible[first:behind] = behind - first >= FEWEST_ALIKE
    return credible if credible.any() else np.ones(len(t_ns), dtype=np.bool_)


def clock_verdict(first_ns: int, last_ns: int, received_ns: int) -> Reason | None:
    """Return why the place of a recording on the vehicle's clock cannot be believed; None where it can."""
    days = (last_ns - first_ns) / DAY_NS
    if last_ns - first_ns > LONGEST_SPAN_NS:
        text = (
            f"the recording spans {days:,.0f} days of the vehicle's clock, at most {LONGEST_SPAN_NS // DAY_NS} may be"
        )
        return Reason(ReasonCode.CLOCK_IMPLAUSIBLE, text)
    if received_ns >= OUR_CLOCK_SET_NS and last_ns > received_ns + MOST_AHEAD_NS:
        ahead = (last_ns - received_ns) / DAY_NS
        text = f"the vehicle's clock is {ahead:,.1f} days ahead of ours: one of both is wrong"
        return Reason(ReasonCode.CLOCK_IMPLAUSIBLE, text)
    return None


MOST_SPEED = 200.0  # m/s
MOST_ODOMETER = 1e11  # m; the registry takes no more either
SPARE_M = 30.0  # by which odometer and speed may differ within a window
SPARE_SHARE = 0.2  # of the distance run, besides: wheels slip, and their radius on file is another
STEPS = 2.0  # of the odometer, besides


def possible_motion(values: FloatArray) -> FloatArray:
    """Return speed and odometer (n, 2) with NaN where no vehicle has such a one."""
    possible = values.copy()
    with np.errstate(invalid="ignore"):
        possible[~(np.abs(possible[:, 0]) <= MOST_SPEED), 0] = np.nan
        possible[~((possible[:, 1] >= 0.0) & (possible[:, 1] <= MOST_ODOMETER)), 1] = np.nan
    return possible


def odometer_excess(tick: IntArray, values: FloatArray, interval_s: float, longest: int) -> float:
    """Return by how much odometer and integral of the speed differ beyond what they may, m; 0 where they do not.

    Values (n, 2) are speed, m/s, and odometer, m; NaN where not known.
    """
    complete = ~np.isnan(values).any(axis=1)
    at, (speed, odometer) = tick[complete], values[complete].T
    near = np.diff(at) <= longest
    run = (0.5 * interval_s * np.diff(at) * (np.abs(speed[1:]) + np.abs(speed[:-1])))[near]
    steps = np.abs(np.diff(odometer))[near]
    if not near.any():
        return 0.0
    step = float(np.median(steps[steps > 0.0])) if steps.any() else 0.0
    allowed = SPARE_M + SPARE_SHARE * float(run.sum()) + STEPS * step
    return max(float(np.abs(np.cumsum(steps - run)).max()) - allowed, 0.0)


LIMIT_M = 50.0
"""From the line: a receiver in a train is right within 5-10 m (one std), a line on a map within 5 m, and the chord of
a radius of 300 m leaves the rail by 17 m over the 200 m that two points may be apart; three std and the chord are
50 m."""

ALONG_M = 200.0
"""The line is looked for this far on both sides of the reported distance: odometry between balises may be off by 5 m
and 5 % (ETCS, SUBSET-041), which is 200 m after 3.9 km; a fix that is a second old is 80 m behind at most."""

FEWEST_FIXES = 3  # of a window. The median counts: fewer than half may be outliers.
SEMI_MAJOR_M, ECCENTRICITY2 = 6_378_137.0, 6.694_379_990_14e-3  # of WGS84 (NIMA TR8350.2)


def off_line_m(line: SectionLine, distance: FloatArray, fixes: FloatArray) -> float:
    """Return how far from a section's line the vehicle was, m; 0 where it was on it within the limit, or nobody knows.

    Args:
        distance: (n,) m along it, as the vehicle reports them; NaN where it does not.
        fixes: (n, 2) latitude and longitude, deg; NaN without a fix. Receivers also send 0, 0 then.
    """
    points = np.array(line, dtype=np.float64)
    points[:, 2] = np.unwrap(points[:, 2], period=360.0)
    with np.errstate(invalid="ignore"):
        near = np.isfinite(fixes).all(axis=1) & (fixes != 0.0).any(axis=1)
        near &= (distance >= points[0, 0]) & (distance <= points[-1, 0])
    if np.count_nonzero(near) < FEWEST_FIXES:
        return 0.0
    pairs = zip(distance[near].tolist(), fixes[near], strict=True)
    median = float(np.median([_from_line(points, at, fix) for at, fix in pairs]))
    return median if median > LIMIT_M else 0.0


def steps_m(line: SectionLine) -> FloatArray:
    """Return the straight distances (n - 1,) between the points of a line, m."""
    points = np.array(line, dtype=np.float64)
    return np.array([float(np.hypot(*_local(points[i + 1 : i + 2], points[i, 1:])[0])) for i in range(len(points) - 1)])


def _local(points: FloatArray, origin: FloatArray) -> FloatArray:
    """Return points (n, 2) east and north of a place, m: exact nearby, of the right order of magnitude afar."""
    latitude = np.deg2rad(0.5 * (points[:, 1] + origin[0]))
    bent = 1.0 - ECCENTRICITY2 * np.sin(latitude) ** 2
    across = SEMI_MAJOR_M / np.sqrt(bent)
    along = across * (1.0 - ECCENTRICITY2) / bent
    east = (points[:, 2] - origin[1] + 180.0) % 360.0 - 180.0
    north = points[:, 1] - origin[0]
    return np.column_stack([np.deg2rad(east) * across * np.cos(latitude), np.deg2rad(north) * along])


def _from_line(points: FloatArray, at: float, fix: FloatArray) -> float:
    first, last = max(at - ALONG_M, points[0, 0]), min(at + ALONG_M, points[-1, 0])
    low, high = np.searchsorted(points[:, 0], [first, last], side="right")
    ends = np.array([[s, *(np.interp(s, points[:, 0], points[:, k]) for k in (1, 2))] for s in (first, last)])
    flat = _local(np.vstack([ends[:1], points[low:high], ends[1:]]), fix)
    begin, step = flat[:-1], np.diff(flat, axis=0)
    length2 = np.maximum((step**2).sum(axis=1), 1e-12)
    share = np.clip(-(begin * step).sum(axis=1) / length2, 0.0, 1.0)
    return float(np.hypot(*(begin + share[:, None] * step).T).min())


LEAST_RUN = 2.0  # m: less is the resolution of a position
REPEATED_SPARE_M = 1.0  # by which positions before and behind may differ from the speed
REPEATED_SPARE_SHARE = 0.02  # of the distance run, besides
SECTION, DISTANCE = 0, 1


def without_repeats(tick: IntArray, values: FloatArray, run: FloatArray) -> FloatArray:
    """Return positions (n, m) with those that repeat replaced by where the vehicle was, or NaN.

    Without reception, in a tunnel, many units send their last position again. The first of equal positions was
    measured, where another one was before it. Where the next one that differs is as far on as the speed says, the
    vehicle has been where the speed puts it in between; otherwise its place is not known there.

    Args:
        values: (n, m) section and distance, m, and what else is sent; NaN where not available.
        run: (n,) m that the vehicle has run by the speed; NaN where that is not known.
    """
    if len(tick) < 2:  # noqa: PLR2004 - nothing is repeated
        return values
    place = values[:, (SECTION, DISTANCE)]
    begins = np.flatnonzero(np.concatenate([[True], np.any(place[1:] != place[:-1], axis=1)]))
    behind = np.append(begins[1:], len(tick))
    with np.errstate(invalid="ignore"):
        repeated = run[np.minimum(behind, len(tick) - 1)] - run[begins] > LEAST_RUN
    repeated &= behind - begins > 1
    if not repeated.any():
        return values
    cleaned = values.copy()
    for first, last in zip(begins[repeated], behind[repeated], strict=True):
        cleaned[first + 1 : last, DISTANCE] = _repeated_between(values, run, int(first), int(last))
    if repeated[0]:
        cleaned[: behind[0], DISTANCE] = np.nan  # it may have been repeated before
    return cleaned


def _repeated_between(values: FloatArray, run: FloatArray, first: int, behind: int) -> FloatArray:
    nowhere = np.full(behind - first - 1, np.nan)
    if behind == len(run) or values[behind, SECTION] != values[first, SECTION]:
        return nowhere
    moved, rolled = values[behind, DISTANCE] - values[first, DISTANCE], run[behind] - run[first]
    if not abs(abs(moved) - rolled) <= REPEATED_SPARE_M + REPEATED_SPARE_SHARE * rolled:
        return nowhere
    passed = (run[first + 1 : behind] - run[first]) / rolled
    return np.asarray(values[first, DISTANCE] + moved * passed)
