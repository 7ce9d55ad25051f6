"""Wheel and rail apart at one amplitude: which cells are connected, and what holds their level."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from estimation.rails.cell_table import CellTable
from estimation.rails.component import Component, component
from estimation.rails.connections import Runs, connected, islands
from estimation.rails.measured_wheels import Check, checks
from estimation.rails.parameters import Anchors, RailsParameters
from estimation.rails.published import RailAt, WheelAt, parted
from estimation.rails.trend_line import TrendAt
from estimation.rails.two_way import Parted, part
from estimation.values.arrays import BoolArray, FloatArray, IntArray
from estimation.values.rails import RailKey, WheelKey
from estimation.values.reasons import Reason, ReasonCode

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


NOT_COVERED = Reason(ReasonCode.AMPLITUDE_NOT_COVERED, "no wheelset has moved as far as this amplitude there")
UNEVEN = Reason(
    ReasonCode.RAILS_INTERACT,
    "conicities rise with those of the wheels otherwise than on most sections, as next to a contact jump",
)
UNCONFIRMED = "it was measured, but nothing else that holds the level confirms it: two measured wheelsets are needed"


@dataclass(slots=True)
class AtAmplitude:
    """What is published at one amplitude."""

    rails: dict[RailKey, RailAt] = field(default_factory=dict)
    wheels: dict[WheelKey, WheelAt] = field(default_factory=dict)
    trends: dict[str, TrendAt] = field(default_factory=dict)  # of sections with rails that were parted, or why not
    interaction: float = float("nan")  # of the component with most cells


def at_amplitude(table: CellTable, k: int, anchors: Anchors, parameters: RailsParameters) -> AtAmplitude:
    """Return what is published at an amplitude, for every wheel and every rail that has cells."""
    level, left_out = _Level.of(table, k, anchors).even(parameters)
    level, confirmed = level.confirmed(parameters)
    level = level.widened(confirmed)
    groups = connected(level.runs, parameters.least_wheelsets)
    refused, covered = groups.refused | dict.fromkeys(left_out, UNEVEN), table.given(k)
    found = AtAmplitude()
    for place, key in enumerate(table.rails):
        found.rails[key] = RailAt.unknown(refused.get(place, NOT_COVERED))
    for row in (~covered).nonzero()[0].tolist() + covered.nonzero()[0].tolist():  # what is known there comes last
        why = refused.get(int(table.rail[row]), NOT_COVERED) if covered[row] else NOT_COVERED
        found.wheels[table.wheels[table.wheel[row]]] = WheelAt.unknown(why)
    most = 0
    for one in level.components(groups.group):
        answer = parted(one, level.anchors.wheel, parameters)
        found.rails.update(answer.rails)
        found.wheels.update(answer.wheels)
        for section, trend in answer.trends.items():
            if section not in found.trends or found.trends[section].periods < trend.periods:
                found.trends[section] = trend
        if len(one.cells) > most:
            most, found.interaction = len(one.cells), answer.interaction
    for place, why in sorted(refused.items()):
        found.trends.setdefault(table.rails[place].section, TrendAt.unknown(why))
    return found


def wheel_checks(table: CellTable, k: int, anchors: Anchors, parameters: RailsParameters) -> dict[str, Check]:
    """Return by serial how far measured wheelsets are from what the others say at an amplitude."""
    return _Level.of(table, k, anchors).even(parameters)[0].confirmed(parameters)[1]


@dataclass(frozen=True, slots=True, eq=False)
class _Level:
    """The cells that are known at an amplitude, and what holds their level there."""

    table: CellTable
    k: int
    anchors: Anchors
    given: BoolArray  # (n,) which cells are known
    known: tuple[FloatArray, FloatArray]  # (w,) conicity of measured wheels and its std; NaN

    @staticmethod
    def of(table: CellTable, k: int, anchors: Anchors) -> _Level:
        value, std = np.full((2, len(table.wheels)), np.nan)
        places = {key: place for place, key in enumerate(table.wheels)} if anchors.known_wheels else {}
        for one in anchors.known_wheels:
            if one.wheel in places and np.isfinite([one.conicity[k], one.std[k]]).all():
                value[places[one.wheel]], std[places[one.wheel]] = one.conicity[k], one.std[k]
        return _Level(table, k, anchors, table.given(k), (value, std))

    @property
    def cells(self) -> IntArray:
        """Numbers of the cells that are known."""
        return np.flatnonzero(self.given)

    @property
    def runs(self) -> Runs:
        """Which wheel ran where."""
        table, cells = self.table, self.cells
        known_rail = np.array([key in self.anchors.known_rails for key in table.rails], np.bool_)
        return Runs(table.wheel[cells], table.rail[cells], table.serial, known_rail, np.isfinite(self.known[0]))

    def components(self, group: IntArray) -> Iterator[Component]:
        """Return the cells of each group of rails (s,)."""
        cells = self.cells
        own = group[self.table.rail[cells]]
        order = np.argsort(own, kind="stable")
        bounds = np.flatnonzero(np.diff(own[order])) + 1
        for some in np.split(cells[order], bounds):
            if len(some) and group[self.table.rail[some[0]]] >= 0:
                known_rails, level_open = self.anchors.known_rails, self.anchors.level_open
                yield component(self.table, some, self.k, self.known, known_rails, level_open)

    def even(self, parameters: RailsParameters) -> tuple[_Level, list[int]]:
        """Return the level without the cells of uneven rails, and the numbers of these."""
        level, found = self, list[int]()
        while self.anchors.known_rails or np.isfinite(self.known[0]).any():
            apart = replace(level.runs, known_wheel=np.zeros(len(level.table.wheels), np.bool_))
            some = [place for one in level.components(islands(apart)) for place in uneven(one, parameters)]
            if not some:
                break
            found += some
            level = replace(level, given=level.given & ~np.isin(level.table.rail, found))
        return level, found

    def checks(self, parameters: RailsParameters) -> dict[str, Check]:
        """Return by serial how far measured wheelsets are from what the others say."""
        found: dict[str, Check] = {}
        if np.isfinite(self.known[0]).any():
            apart = replace(self.runs, known_wheel=np.zeros(len(self.table.wheels), np.bool_))
            for one in self.components(islands(apart)):
                found |= checks(one, self.anchors.wheel, parameters)
        return found

    def confirmed(self, parameters: RailsParameters) -> tuple[_Level, dict[str, Check]]:
        """Return the level without measured wheelsets of which the others say too little, and what of those left."""
        level = self
        while True:
            found = level.checks(parameters)
            few = {name for name, one in found.items() if one.std > parameters.confirmed_within}
            if not few:
                return level, found
            level = level.without(few)

    def widened(self, found: Mapping[str, Check]) -> _Level:
        """Return the level with errors of measured wheelsets that are no smaller than what the others leave open."""
        of_others = np.array([found[key.wheelset].std if key.wheelset in found else 0.0 for key in self.table.wheels])
        return replace(self, known=(self.known[0], np.hypot(self.known[1], of_others)))

    def without(self, serials: set[str]) -> _Level:
        """Return the level that some measured wheelsets hold no more."""
        own = np.array([key.wheelset in serials for key in self.table.wheels])
        value, std = (np.where(own, np.nan, one) for one in self.known)
        why = dict.fromkeys(serials, Reason(ReasonCode.RAILS_LEVEL_OPEN, UNCONFIRMED))
        return replace(self, anchors=self.anchors.without({}, why), known=(value, std))
