"""Wheel and rail apart at one amplitude: which cells are connected, and what holds their level."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from estimation.rails.cell import Anchors, CellTable, ReferenceWheel
from estimation.rails.component import Component, Runs, component, connected, islands
from estimation.rails.parameters import RailsParameters
from estimation.rails.published import AtAmplitude, RailAt, TrendAt, WheelAt, parted, refusal
from estimation.rails.two_way import Parted, part, with_known
from estimation.values.arrays import BoolArray, FloatArray, IntArray
from estimation.values.quantities import Estimate, with_interval
from estimation.values.reasons import Reason, ReasonCode


@dataclass(frozen=True, slots=True)
class Check:
    """What the others say of the wheels of a measured wheelset, where it is furthest from that."""

    apart: float  # by how much its conicity as measured is above that
    half: float  # half interval of the difference
    std: float  # of what the others say

    @property
    def ratio(self) -> float:
        """Half intervals between both."""
        return abs(self.apart) / self.half


def checks(component: Component, wheel: ReferenceWheel, parameters: RailsParameters) -> dict[str, Check]:
    """Return by serial how far measured wheelsets are from what the others say; infinite stds where these say nothing.

    None are said to differ at an amplitude at which nothing is published.
    """
    known = np.isfinite(component.two_way.known_value)
    if not known.any():
        return {}
    nothing = np.full(len(known), np.nan)
    alone = part(replace(component.two_way, known_value=nothing), parameters)
    held = with_known(component.two_way, parameters, alone)
    usable = held.converged and refusal(component, alone, wheel, parameters) is None
    serial, shared = component.table.serial[component.wheel], component.shared
    found = {}
    for one in np.unique(serial[known]).tolist():
        own = np.flatnonzero(known & (serial == one))
        checked = _check(component, held, own, shared, parameters) if held.converged else NOTHING
        found[component.table.serials[one]] = checked if usable else replace(checked, apart=0.0)
    return found


def _check(component: Component, held: Parted, own: IntArray, shared: float, parameters: RailsParameters) -> Check:
    left, covariance = _left_out(component, held, own)
    variance = np.diag(covariance)
    if not ((variance > 0.0) & (variance < parameters.largest_conicity_variance)).all():
        return NOTHING
    value = component.two_way.known_value
    others = np.isfinite(value)
    others[own] = False
    level = 0.0 if component.two_way.known_rail.any() or not others.any() else float(value[others].mean())
    sampled = np.sqrt(1.0 / held.known_weight[own] + variance)
    systematic = shared * np.abs(value[own] - level)
    groups = 1 + max(1, int(held.freedom))
    intervals = [with_interval(*one, groups) for one in zip(left.tolist(), sampled, systematic, strict=True)]
    half = np.array([(one.high or 0.0) - (one.value or 0.0) for one in intervals])
    worst = int(np.argmax(np.abs(left) / half))
    return Check(float(left[worst]), float(half[worst]), float(np.sqrt(variance.max())))


def _left_out(component: Component, held: Parted, own: IntArray) -> tuple[FloatArray, FloatArray]:
    """Return by how much measured wheels (m,) are above what the others say, and the covariance (m, m) of that."""
    shared, weight = held.shared[own], np.diag(held.known_weight[own])
    with_own = np.diag(1.0 / held.own[own]) + shared @ (shared @ held.covariance).T
    apart = np.eye(len(own)) - with_own @ weight
    residual = component.two_way.known_value[own] - held.wheel[own]
    try:
        return np.linalg.solve(apart, residual), np.linalg.solve(apart, with_own)
    except np.linalg.LinAlgError:  # they alone hold their level
        return residual, np.full_like(apart, np.inf)


NOTHING = Check(0.0, np.inf, np.inf)


def uneven(component: Component, parameters: RailsParameters) -> list[int]:
    """Return the numbers of the rails that are uneven, where something holds the level and these would move it."""
    # Uneven are rails on which conicities rise with those of the wheels otherwise than on half of all rails or more,
    # themselves counted. Of two that differ both are; what is known is not.
    two_way = component.two_way
    if not two_way.anchored:
        return []
    nothing = np.full(len(two_way.known_value), np.nan)
    alone = part(replace(two_way, known_value=nothing), parameters)
    if not alone.converged or not _spread_std(component, alone, parameters) > parameters.spread_open:
        return []
    rise = np.log1p(alone.slope)
    alike = np.abs(rise[:, None] - rise[None, :]) <= np.log1p(parameters.uneven_slope)
    found: list[int] = component.rail[(alike.mean(axis=1) <= parameters.uneven_share) & ~two_way.known_rail].tolist()
    return found


def _spread_std(component: Component, alone: Parted, parameters: RailsParameters) -> float:
    """Return the relative std of how far conicities of wheels are spread, by known rails and nothing else."""
    # it is that of the mean slope of the other rails, less what is known of it beforehand
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


def at_amplitude(table: CellTable, k: int, anchors: Anchors, parameters: RailsParameters) -> AtAmplitude:
    """Return what is published at an amplitude, for every wheel and every rail that has cells."""
    level, left_out = _Level.of(table, k, anchors).even(parameters)
    level, confirmed = level.confirmed(parameters)
    level = level.widened(confirmed)
    groups, unconnected = connected(level.runs, parameters.least_wheelsets)
    refused, covered = unconnected | dict.fromkeys(left_out, UNEVEN), table.given(k)
    found = AtAmplitude()
    for place, key in enumerate(table.rails):
        found.rails[key] = RailAt.unknown(refused.get(place, NOT_COVERED))
    for row in (~covered).nonzero()[0].tolist() + covered.nonzero()[0].tolist():  # what is known there comes last
        why = refused.get(int(table.rail[row]), NOT_COVERED) if covered[row] else NOT_COVERED
        found.wheels[table.wheels[table.wheel[row]]] = WheelAt(None, Estimate.unknown(why))
    most = 0
    for one in level.components(groups):
        answer = parted(one, level.anchors.wheel, parameters)
        found.rails.update(answer.rails)
        found.wheels.update(answer.wheels)
        for section, trend in answer.trends.items():
            if section not in found.trends or found.trends[section].periods < trend.periods:
                found.trends[section] = trend
        if len(one.cells) > most:
            most, found.interaction = len(one.cells), answer.interaction
    for place, why in sorted(refused.items()):
        found.trends.setdefault(table.rails[place].section, TrendAt(Estimate.unknown(why)))
    return found


def wheel_checks(table: CellTable, k: int, anchors: Anchors, parameters: RailsParameters) -> dict[str, Check]:
    """Return by serial how far measured wheelsets are from what the others say at an amplitude."""
    return _Level.of(table, k, anchors).even(parameters)[0].confirmed(parameters)[1]


@dataclass(frozen=True, slots=True, eq=False)
class _Level:
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
        return np.flatnonzero(self.given)

    @property
    def runs(self) -> Runs:
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
