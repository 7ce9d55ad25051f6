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
    """Return the numbers of the rails that are uneven, where something holds the level and these would move it.

    Uneven are rails on which conicities rise with those of the wheels otherwise than on half of all rails or more,
    themselves counted. Of two that differ both are; what is known is not.
    """
    two_way = component.two_way
    if not two_way.anchored:
        return []
    nothing = np.full(len(two_way.known_value), np.nan)
    alone = part(replace(two_way, known_value=nothing), parameters)
    if not alone.converged or not _spread_std(component, alone, parameters) > parameters.spread_open:
        return []
    rise = np.log1p(alone.slope)
    alike = np.abs(rise[:, None] - rise[None, :]) <= np.log1p(parameters.uneven_slope)
    found: list[int] = component.rail[(alike.mean(axis=1) <= MOST) & ~two_way.known_rail].tolist()
    return found


def _spread_std(component: Component, alone: Parted, parameters: RailsParameters) -> float:
    """Return the relative std of how far conicities of wheels are spread, by known rails and nothing else.

    It is that of the mean slope of the other rails, less what is known of it beforehand.
    """
    free = ~component.two_way.known_rail
    s, count = len(free), int(free.sum())
    if count == 0:
        return 0.0
    if count == s:
        return np.inf
    variance = float(alone.covariance[s:, s:][np.ix_(free, free)].sum()) / count**2
    precision = 1.0 / variance - count / parameters.slope_std**2
    return precision**-0.5 if precision > 0.0 else np.inf
