"""Which mileages of a wheelset can be believed: against its mounting, against speed and time, against each other.

Within one mounting the mileage grows with time, and not faster than the vehicle can run. The largest set of windows of
which that holds is believed. A few others (a garbled recording) are left out of it. Where the odometer fell and did not
come back it was exchanged or reset: what was before is believed, and nothing after until the mounting is registered
again. The verdict depends on the set of windows, not on their order of arrival.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Iterable, Mapping, Sequence
from itertools import pairwise

import numpy as np

from estimation.motion.parameters import MOTION
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.registry import Mounting
from estimation.values.roll_up import Odometer
from estimation.values.units import DAY_S, HOUR_S, SECOND_NS
from estimation.values.windows import MileageReading, WindowRecord


def implausible_mileages(
    readings: Sequence[MileageReading], mounting: Mounting, max_speed_m_s: float
) -> Mapping[int, Reason]:
    """Return by start of window why its mileage is not believed; those that are not in it are."""
    km_per_ns = MOTION.speed_slack_factor * max_speed_m_s / 1000.0 / SECOND_NS
    reasons: dict[int, Reason] = {}
    rest = []
    for reading in sorted(readings, key=lambda item: item.start_ns):
        reason = _alone(reading, mounting, km_per_ns)
        if reason is None:
            rest.append(reading)
        else:
            reasons[reading.start_ns] = reason
    believed = {reading.start_ns for reading in _believed(rest, km_per_ns)}
    out_of_line = Reason(
        ReasonCode.ODOMETER_IMPLAUSIBLE,
        "the odometer does not go with that of the vehicle's other windows: it fell, or rose faster than it can",
    )
    return reasons | {item.start_ns: out_of_line for item in rest if item.start_ns not in believed}


def without_doubt(readings: Sequence[MileageReading], mounting: Mounting, max_speed_m_s: float) -> bool:
    """Whether nothing speaks against any reading."""
    # Where that holds of all readings of a mounting it also holds of any of them. So it holds of all and new ones as
    # soon as it holds of the new ones with those beside them.
    km_per_ns = MOTION.speed_slack_factor * max_speed_m_s / 1000.0 / SECOND_NS
    ordered = sorted(readings, key=lambda reading: reading.start_ns)
    return all(_follows(*pair, km_per_ns) for pair in pairwise(ordered)) and all(
        _alone(item, mounting, km_per_ns) is None for item in ordered
    )


def implausible_places(readings: Sequence[MileageReading]) -> Mapping[int, Reason]:
    """Return by start of window why the place that its vehicle reported is not believed."""
    return {
        reading.start_ns: Reason(
            ReasonCode.PLACE_IMPLAUSIBLE, f"by GNSS {reading.off_line_m:,.0f} m from the line of the section reported"
        )
        for reading in readings
        if reading.off_line_m > 0.0
    }


def _alone(reading: MileageReading, mounting: Mounting, km_per_ns: float) -> Reason | None:
    mileage = reading.mileage_km
    text = ""
    run = mileage - mounting.wheelset_mileage_km
    farthest = MOTION.slack_km + km_per_ns * (reading.start_ns - mounting.from_ns)
    if not np.isfinite(mileage) or abs(mileage) > MOTION.most_mileage_km:
        text = f"a mileage of {mileage:g} km is none of a wheelset"
    elif run < -MOTION.slack_km:
        text = f"the odometer is {-run:,.0f} km below its reading at the mounting"
    elif run > farthest:
        text = f"the wheelset would have run {run:,.0f} km since its mounting, {farthest:,.0f} km are possible"
    elif reading.odometer_excess_m > 0.0:
        text = f"odometer and speed differ by {reading.odometer_excess_m:,.0f} m more than they may"
    return Reason(ReasonCode.ODOMETER_IMPLAUSIBLE, text) if text else None


def _believed(readings: Sequence[MileageReading], km_per_ns: float) -> Sequence[MileageReading]:
    if all(_follows(*pair, km_per_ns) for pair in pairwise(readings)):
        return readings
    chain = _longest_chain(readings, km_per_ns)
    before = [item for item in readings if item.start_ns < chain[0].start_ns]
    if before and _journeys(_longest_chain(before, km_per_ns)) >= MOTION.agreeing_journeys:
        return _believed(before, km_per_ns)
    members = {item.start_ns for item in chain}
    run: list[MileageReading] = []  # in a row that are not in the chain
    for number, reading in enumerate(readings):
        if reading.start_ns not in members:
            run.append(reading)
            continue
        tail = _led_here([*run, reading], km_per_ns)
        if run and tail[0].start_ns > chain[0].start_ns and _journeys(tail[:-1]) >= MOTION.agreeing_journeys:
            return _believed(readings[: number + 1 - len(tail)], km_per_ns)  # another odometer, that caught up
        run = []
    return chain


def _led_here(readings: Sequence[MileageReading], km_per_ns: float) -> Sequence[MileageReading]:
    """Return the last readings of which each follows the one before; the last alone where it does not."""
    first = len(readings) - 1
    while first and _follows(readings[first - 1], readings[first], km_per_ns):
        first -= 1
    return readings[first:]


def _follows(first: MileageReading, second: MileageReading, km_per_ns: float) -> bool:
    run = second.mileage_km - first.mileage_km
    return 0.0 <= run <= km_per_ns * (second.start_ns - first.start_ns)


def _longest_chain(readings: Sequence[MileageReading], km_per_ns: float) -> list[MileageReading]:
    """Return the most readings of which each follows the one before; of several such the one that ends first."""
    # A follows B where neither the mileage nor what was not run of the possible distance falls: in the order of the
    # one, that is a longest non-decreasing run of the other
    origin = readings[0].start_ns
    not_run = [km_per_ns * (reading.start_ns - origin) - reading.mileage_km for reading in readings]
    order = sorted(range(len(readings)), key=lambda i: (readings[i].mileage_km, not_run[i]))
    least: list[float] = []  # not_run of the last of the best chain of each length
    last: list[int] = []
    previous: dict[int, int] = {}
    for i in order:
        length = bisect_right(least, not_run[i])
        if length:
            previous[i] = last[length - 1]
        least[length : length + 1] = [not_run[i]]
        last[length : length + 1] = [i]
    chain = [last[-1]]
    while chain[-1] in previous:
        chain.append(previous[chain[-1]])
    return [readings[i] for i in reversed(chain)]


def _journeys(readings: Sequence[MileageReading]) -> int:
    pauses_ns = (second.start_ns - first.start_ns for first, second in pairwise(readings))
    return bool(readings) + sum(pause_ns > MOTION.journey_pause_ns for pause_ns in pauses_ns)


def running_mileage(windows: Sequence[WindowRecord]) -> list[float]:
    """Return the mileage, km, never decreasing, of each window of a wheelset between two reprofilings, oldest first."""
    # where the odometer made no impossible step it is the mileage as stored, bit for bit
    odometer, mileages = first_reading(windows), []
    for window in windows:
        odometer = read(odometer, window)
        mileages.append(odometer.last_km)
    return mileages


def first_reading(windows: Iterable[WindowRecord]) -> Odometer:
    """Return where the chain of mileages begins that has no window before these, which are in order."""
    mileages = (known_mileage(window.mileage_km) for window in windows)
    first = next((value for value in mileages if math.isfinite(value)), 0.0)
    return Odometer(last=first, last_km=first, last_ns=0)


def known_mileage(stored_km: float) -> float:
    """Return a stored mileage, NaN where no wheelset can have run it."""
    return stored_km if abs(stored_km) <= MOTION.most_mileage_km else math.nan


def read(before: Odometer, window: WindowRecord) -> Odometer:
    """Return where the chain of mileages stands after a window; without a reading it says nothing."""
    # it depends on nothing but the last window with a reading, its mileage as stored and as run: so the chain goes on
    # from any window of which both are kept
    stored = known_mileage(window.mileage_km)
    if math.isnan(stored):
        return before
    step, most = stored - before.last, most_km((window.start_ns - before.last_ns) / SECOND_NS)
    if 0.0 <= step <= most:
        # rounded twice where the odometer was exchanged once; it never goes back
        return Odometer(stored, max(before.last_km, stored + (before.last_km - before.last)), window.start_ns)
    return Odometer(stored, before.last_km + min(max(step, 0.0), most), window.start_ns)


def most_km(seconds: float) -> float:
    """Return how far, km, a vehicle can have run in some seconds."""
    return MOTION.most_km_s * min(seconds, HOUR_S) + MOTION.most_km_day * seconds / DAY_S
