"""Rails that add far more to one wheel than to another, unlike most others: a contact jump of theirs is near.

That slopes of rails are 0 but for 0.3 beforehand is true of most. A jump has slopes of 1 and more, and where nothing
but that knowledge says how far the conicities of wheels are spread, one such section pulls those of all others the
other way: the wheels come out too far apart, and their slopes too low. Ratios between slopes need no such knowledge.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from estimation.rails.component import Component
from estimation.rails.parameters import RailsParameters
from estimation.rails.two_way import Parted, part

MOST = 0.5  # share of the rails


def uneven(component: Component, parameters: RailsParameters) -> list[int]:
    """Return the numbers of the rails that are uneven, where measured wheels hold the level and these would move them.

    Uneven are rails on which conicities rise with those of the wheels otherwise than on half of all rails or more,
    themselves counted. Of two that differ both are.

    Parameters
    ----------
    component
        Connected cells, with the measured wheels.
    parameters
        Of the model.
    """
    two_way = component.two_way
    if not np.isfinite(two_way.known_value).any():
        return []
    nothing = np.full(len(two_way.known_value), np.nan)
    alone = part(replace(two_way, known_value=nothing), parameters)
    if not alone.converged or not _spread_open(component, alone, parameters):
        return []
    rise = np.log1p(alone.slope)
    alike = np.abs(rise[:, None] - rise[None, :]) <= np.log1p(parameters.uneven_slope)
    found: list[int] = component.rail[alike.mean(axis=1) <= MOST].tolist()
    return found


def _spread_open(component: Component, alone: Parted, parameters: RailsParameters) -> bool:
    """Whether known rails say little of how far conicities of wheels are spread: of the mean slope of the others."""
    free = ~component.two_way.known_rail
    s, count = len(free), int(free.sum())
    if count == 0:
        return False
    if count == s:
        return True
    variance = float(alone.covariance[s:, s:][np.ix_(free, free)].sum()) / count**2
    return variance > parameters.spread_open**2 * parameters.slope_std**2 / count
