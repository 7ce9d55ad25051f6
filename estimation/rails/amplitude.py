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
    measured = np.isfinite(component.two_way.known_value)
    if not measured.any():
        return {}
    nothing = np.full(len(measured), np.nan)
    alone = part(replace(component.two_way, known_value=nothing), parameters)
    held = with_known(component.two_way, parameters, alone)
    usable = held.converged and refusal(component, alone, wheel, parameters) is None
    serial, shared = component.table.serial[component.wheel], component.shared(parameters.least_conicity)
    by_serial = {}
    for number in np.unique(serial[measured]).tolist():
        wheels = np.flatnonzero(measured & (serial == number))
        checked = _check(component, held, wheels, shared, parameters) if held.converged else NOTHING
        by_serial[component.table.serials[number]] = checked if usable else replace(checked, apart=0.0)
    return by_serial


def _check(component: Component, held: Parted, wheels: IntArray, shared: float, parameters: RailsParameters) -> Check:
    above, covariance = _left_out(component, held, wheels)
    variance = np.diag(covariance)
    if not ((variance > 0.0) & (variance < parameters.largest_conicity_variance)).all():
        return NOTHING
    value = component.two_way.known_value
    others = np.isfinite(value)
    others[wheels] = False
    level = 0.0 if component.two_way.known_rail.any() or not others.any() else float(value[others].mean())
    sampled = np.sqrt(1.0 / held.known_weight[wheels] + variance)
    systematic = shared * np.abs(value[wheels] - level)
    groups = 1 + max(1, int(held.freedom))
    intervals = [with_interval(*row, groups) for row in zip(above.tolist(), sampled, systematic, strict=True)]
    half = np.array([(interval.high or 0.0) - (interval.value or 0.0) for interval in intervals])
    worst = int(np.argmax(np.abs(above) / half))
    return Check(float(above[worst]), float(half[worst]), float(np.sqrt(variance.max())))


def _left_out(component: Component, held: Parted, wheels: IntArray) -> tuple[FloatArray, FloatArray]:
    """Return by how much measured wheels (m,) are above what the others say, and the covariance (m, m) of that."""
    shared, weight = held.shared[wheels], np.diag(held.known_weight[wheels])
    with_own = np.diag(1.0 / held.own[wheels]) + shared @ (shared @ held.covariance).T
    apart = np.eye(len(wheels)) - with_own @ weight
    residual = component.two_way.known_value[wheels] - held.wheel[wheels]
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
    rails: list[int] = component.rail[(alike.mean(axis=1) <= parameters.uneven_share) & ~two_way.known_rail].tolist()
    return rails


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
    published = AtAmplitude()
    for place, key in enumerate(table.rails):
        published.rails[key] = RailAt.unknown(refused.get(place, NOT_COVERED))
    for row in (~covered).nonzero()[0].tolist() + covered.nonzero()[0].tolist():  # what is known there comes last
        why = refused.get(int(table.rail[row]), NOT_COVERED) if covered[row] else NOT_COVERED
        published.wheels[table.wheels[table.wheel[row]]] = WheelAt(None, Estimate.unknown(why))
    most = 0
    for group in level.components(groups):
        answer = parted(group, level.anchors.wheel, parameters)
        published.rails.update(answer.rails)
        published.wheels.update(answer.wheels)
        for section, trend in answer.trends.items():
            if section not in published.trends or published.trends[section].periods < trend.periods:
                published.trends[section] = trend
        if len(group.cells) > most:
            most, published.interaction = len(group.cells), answer.interaction
    for place, why in sorted(refused.items()):
        published.trends.setdefault(table.rails[place].section, TrendAt(Estimate.unknown(why)))
    return published


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
        for measured in anchors.known_wheels:
            if measured.wheel in places and np.isfinite([measured.conicity[k], measured.std[k]]).all():
                place = places[measured.wheel]
                value[place], std[place] = measured.conicity[k], measured.std[k]
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
        group_of_cell = group[self.table.rail[cells]]
        order = np.argsort(group_of_cell, kind="stable")
        bounds = np.flatnonzero(np.diff(group_of_cell[order])) + 1
        for cells_of_group in np.split(cells[order], bounds):
            if len(cells_of_group) and group[self.table.rail[cells_of_group[0]]] >= 0:
                known_rails, level_open = self.anchors.known_rails, self.anchors.level_open
                yield component(self.table, cells_of_group, self.k, self.known, known_rails, level_open)

    def even(self, parameters: RailsParameters) -> tuple[_Level, list[int]]:
        """Return the level without the cells of uneven rails, and the numbers of these."""
        level, uneven_rails = self, list[int]()
        while self.anchors.known_rails or np.isfinite(self.known[0]).any():
            apart = replace(level.runs, known_wheel=np.zeros(len(level.table.wheels), np.bool_))
            more = [rail for island in level.components(islands(apart)) for rail in uneven(island, parameters)]
            if not more:
                break
            uneven_rails += more
            level = replace(level, given=level.given & ~np.isin(level.table.rail, uneven_rails))
        return level, uneven_rails

    def checks(self, parameters: RailsParameters) -> dict[str, Check]:
        by_serial: dict[str, Check] = {}
        if np.isfinite(self.known[0]).any():
            apart = replace(self.runs, known_wheel=np.zeros(len(self.table.wheels), np.bool_))
            for island in self.components(islands(apart)):
                by_serial |= checks(island, self.anchors.wheel, parameters)
        return by_serial

    def confirmed(self, parameters: RailsParameters) -> tuple[_Level, dict[str, Check]]:
        """Return the level without measured wheelsets of which the others say too little, and what of those left."""
        level = self
        while True:
            by_serial = level.checks(parameters)
            unconfirmed = {name for name, check in by_serial.items() if check.std > parameters.confirmed_within}
            if not unconfirmed:
                return level, by_serial
            level = level.without(unconfirmed)

    def widened(self, checked: Mapping[str, Check]) -> _Level:
        """Return the level with errors of measured wheelsets that are no smaller than what the others leave open."""
        stds = {serial: check.std for serial, check in checked.items()}
        of_others = np.array([stds.get(key.wheelset, 0.0) for key in self.table.wheels])
        return replace(self, known=(self.known[0], np.hypot(self.known[1], of_others)))

    def without(self, serials: set[str]) -> _Level:
        """Return the level without what some measured wheelsets hold of it."""
        unconfirmed = np.array([key.wheelset in serials for key in self.table.wheels])
        value, std = (np.where(unconfirmed, np.nan, values) for values in self.known)
        why = dict.fromkeys(serials, Reason(ReasonCode.RAILS_LEVEL_OPEN, UNCONFIRMED))
        return replace(self, anchors=self.anchors.without({}, why), known=(value, std))
