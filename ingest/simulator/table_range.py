"""How far the contact table of a wheelset reaches, and where a wheelset climbs the rail."""

from __future__ import annotations

import math

import numpy as np

from estimation.contact.table import ContactTable
from estimation.values.arrays import FloatArray
from ingest.simulator.motion import WheelsetMotion
from ingest.simulator.scenario import Scenario
from ingest.simulator.track import TrackTruth

DISPLACEMENT_LIMIT = 8e-3  # m
DRAWN_LIMIT = 12e-3  # m, the same of a drawn fleet, whose worn wheelsets swing further
DRAWN_LIMIT_WIDE = 15e-3  # m, the same where gauge varies: flanges are further apart in wide gauge
GAUGE_LIMIT = 10e-3  # m, of a listed fleet where gauge varies: flange contact is at some 7 mm
ROUGH_LIMIT = 15e-3  # m, on tracks and with wheels as they are recorded: flanges run up to 10 mm, and come back
LIMIT_STEP = 0.5e-3  # m
GAUGE_STEP = 0.5e-3  # m: contact jumps move over y - d by half the gauge deviation, and tables blend between steps


def gauge_grid(track: TrackTruth) -> FloatArray:
    """Return the gauge deviations (g,) that a contact table needs for ``track``: one where the gauge is constant."""
    low, high = track.gauge_range()
    if high - low < 1e-9:  # noqa: PLR2004 - a nanometre is constant
        return np.array([0.5 * (low + high)])
    first, last = np.floor(low / GAUGE_STEP), np.ceil(high / GAUGE_STEP)
    return np.asarray(GAUGE_STEP * np.arange(first, last + 1.0))


def displacement_limit(scenario: Scenario, track: TrackTruth) -> float:
    """Return the lateral displacement, m, beyond which a wheelset of the scenario derails.

    Args:
        scenario: Listed or drawn fleet; recorded track or recipe.
        track: The true track: in wide gauge flange contact comes later, by half the gauge deviation.
    """
    recipe = scenario.section.recipe
    _, widest = track.gauge_range()
    more = _rounded_up(0.5 * max(widest, 0.0))
    varied = track.surface is not None or bool(scenario.running.stretches)
    if recipe is None or not recipe.plain or scenario.files or varied:
        return ROUGH_LIMIT + more
    if recipe.gauge_std > 0.0:
        wide = GAUGE_LIMIT + more
        return wide if scenario.drawn is None else max(wide, DRAWN_LIMIT_WIDE)
    return more + (DISPLACEMENT_LIMIT if scenario.drawn is None else DRAWN_LIMIT)


def _rounded_up(length: float) -> float:
    return LIMIT_STEP * math.ceil(length / LIMIT_STEP - 1e-9)


def first_climb(table: ContactTable, motion: WheelsetMotion) -> int | None:
    """Return the first sample of a motion at which a wheel climbs its rail; None where there is none.

    A wheel climbs where the wheelset is beyond the table, or where the table has no contact of both wheels (its values
    are those of the nearest displacement that has one).
    """
    if motion.outside == 0 and table.exists.all():
        return None
    x = table.lateral_displacement
    first = np.argmax(table.exists, axis=0)
    last = len(x) - 1 - np.argmax(table.exists[::-1], axis=0)
    low = np.interp(motion.gauge_deviation, table.gauge_deviation, x[first])
    high = np.interp(motion.gauge_deviation, table.gauge_deviation, x[last])
    beyond = ~((motion.relative_displacement >= low) & (motion.relative_displacement <= high))  # NaN is beyond
    return int(np.argmax(beyond)) if beyond.any() else None
