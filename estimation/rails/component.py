"""Cells that wheelsets connect, at one amplitude, as the mixed model takes them.

Rails are nodes, and what is known is one; a wheel connects all rails that it ran on, and a wheel that is known itself
connects them with what is known. Rails that one wheelset alone connects have no more than its word: where it was
measured wrongly, or turned and nobody said so, all of them are off by that.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components, minimum_spanning_tree

from estimation.rails.cell import CellTable
from estimation.rails.two_way import TwoWay
from estimation.values.arrays import BoolArray, FloatArray, IntArray
from estimation.values.opinions import RailKey, WheelKey
from estimation.values.reasons import Reason, ReasonCode


@dataclass(frozen=True, slots=True, eq=False)
class Component:
    """Cells that are connected, at one amplitude."""

    table: CellTable  # of all cells
    cells: IntArray  # (n,) numbers of those that are connected
    k: int  # number of the amplitude
    wheel: IntArray  # (w,) numbers of its wheels, in the order in which they are solved
    rail: IntArray  # (s,) numbers of its rails likewise
    two_way: TwoWay
    level_open: Reason  # what is said where nothing holds the level

    @property
    def wheels(self) -> list[WheelKey]:
        """The wheels, in the order in which they are solved."""
        return [self.table.wheels[place] for place in self.wheel]

    @property
    def rails(self) -> list[RailKey]:
        """The rails, in the order in which they are solved."""
        return [self.table.rails[place] for place in self.rail]

    def shared(self, least_conicity: float) -> float:
        """Return what is systematic in all cells, relative: the median of what is not the scale of the section."""
        conicity = np.maximum(np.abs(self.table.conicity[self.cells, self.k]), least_conicity)
        relative = self.table.systematic[self.cells, self.k] / conicity
        return float(np.median(np.sqrt(np.maximum(relative**2 - self.table.scale[self.cells] ** 2, 0.0))))

    def by_rail(self, values: FloatArray) -> FloatArray:
        """Return the mean (s,) of what belongs to cells (n,), over those of each of the rails."""
        rail, s = self.two_way.rail, len(self.rail)
        return np.bincount(rail, values, minlength=s) / np.bincount(rail, minlength=s)


def component(
    table: CellTable,
    cells: IntArray,
    k: int,
    known: tuple[FloatArray, FloatArray],
    known_rails: frozenset[RailKey],
    level_open: Reason,
) -> Component:
    """Return connected cells with what is known of their rails and of the conicity (w,) of all wheels, or NaN."""
    wheel, of_wheel = np.unique(table.wheel[cells], return_inverse=True)
    rail, of_rail = np.unique(table.rail[cells], return_inverse=True)
    value, std = known
    two_way = TwoWay(
        wheel=of_wheel,
        rail=of_rail,
        value=table.conicity[cells, k],
        variance=table.sampled[cells, k] ** 2,
        known_rail=np.array([table.rails[place] in known_rails for place in rail], np.bool_),
        known_value=value[wheel],
        known_variance=std[wheel] ** 2,
    )
    return Component(table, cells, k, wheel, rail, two_way, level_open)


NOT_CONNECTED = Reason(
    ReasonCode.RAILS_NOT_CONNECTED, "no wheelset that runs there runs on another section at this amplitude"
)
ON_ONE_WHEELSET = Reason(
    ReasonCode.TOO_FEW_WHEELSETS, "one wheelset alone connects the section, and those next to it, to the reference"
)


@dataclass(frozen=True, slots=True)
class Runs:
    """Which wheel ran on which rails, at one amplitude."""

    wheel: IntArray  # (n,) number of the wheel
    rail: IntArray  # (n,) number of the rails
    serial: IntArray  # (w,) number of the wheelset of each wheel
    known_rail: BoolArray  # (s,)
    known_wheel: BoolArray  # (w,)

    def nodes(self) -> IntArray:
        """Return the node (n,) of the rails; that of all that are known is s."""
        s = len(self.known_rail)
        return np.where(self.known_rail[self.rail], s, self.rail)

    def pairs(self) -> tuple[IntArray, IntArray]:
        """Return which wheel (m,) is on which node (m,), each pair once; wheels that are known are on that as well."""
        s = len(self.known_rail)
        ran = np.unique(self.wheel)
        known = ran[self.known_wheel[ran]]
        wheel, node = np.concatenate([self.wheel, known]), np.concatenate([self.nodes(), np.full(len(known), s)])
        return np.divmod(np.unique(wheel * (s + 1) + node), s + 1)


def islands(runs: Runs) -> IntArray:
    """Return by rails (s,) the number of the group that any wheel connects, all that is known counting as connected."""
    s = len(runs.known_rail)
    labels = _labels(*runs.pairs(), s + 1)
    return np.where(runs.known_rail, labels[s], labels[:s])


def connected(runs: Runs, least: int) -> tuple[IntArray, dict[int, Reason]]:
    """Return by rails (s,) the number of their group, solved together, and by number why the others are refused.

    The group is -1 where rails are refused or have no cell. What is refused connects nothing any more.
    """
    # Rails that hang on one wheelset are refused where the others are connected with what is known. Where nothing is
    # known, both sides are groups of their own, for differences within each are known.
    refused: dict[int, Reason] = {}
    while True:
        weak = _weak(runs, least)
        if not weak:
            groups, hanging = _groups(runs)
            weak = dict.fromkeys(hanging, ON_ONE_WHEELSET)
            if not weak:
                present = np.isin(np.arange(len(groups)), runs.rail)
                return np.where(present, groups, -1), refused
        refused |= weak
        kept = ~np.isin(runs.rail, list(weak))
        runs = replace(runs, wheel=runs.wheel[kept], rail=runs.rail[kept])


def _weak(runs: Runs, least: int) -> dict[int, Reason]:
    wheel, _ = runs.pairs()
    links = np.bincount(wheel, minlength=len(runs.serial)) > 1
    linking = links[runs.wheel]
    serials = len(runs.serial) + 1
    rail, _ = np.divmod(np.unique(runs.rail[linking] * serials + runs.serial[runs.wheel[linking]]), serials)
    count = np.bincount(rail, minlength=len(runs.known_rail)).tolist()
    weak = {}
    for place in np.unique(runs.rail[~runs.known_rail[runs.rail]]).tolist():
        if count[place] == 0:
            weak[place] = NOT_CONNECTED
        elif count[place] < least:
            text = f"{count[place]} wheelset{'s' * (count[place] != 1)} connect the section to others"
            weak[place] = Reason(ReasonCode.TOO_FEW_WHEELSETS, f"{text}, {least} are needed")
    return weak


def _groups(runs: Runs) -> tuple[IntArray, list[int]]:
    s = len(runs.known_rail)
    wheel, node = runs.pairs()
    whole = _labels(wheel, node, s + 1)
    of_rail = np.where(runs.known_rail, s, np.arange(s))
    columns = [whole]
    for serial in _needed(wheel, node, runs.serial, s + 1):
        others = runs.serial[wheel] != serial
        columns.append(_labels(wheel[others], node[others], s + 1))
    labels = np.array(columns)[:, of_rail]  # (1 + c, s)
    at_known = np.array(columns)[:, s]
    with_known = whole[of_rail] == whole[s]
    held = (labels == at_known[:, None]).all(axis=0)
    _, blocks, sizes = np.unique(labels, axis=1, return_inverse=True, return_counts=True)
    blocks = blocks.reshape(-1)
    apart = np.where(with_known, ~held, (sizes[blocks] == 1) & ~runs.known_rail)
    present = np.unique(runs.rail)
    return np.where(with_known, -1, blocks) + 1, present[apart[present]].tolist()


def _needed(wheel: IntArray, node: IntArray, serial: IntArray, nodes: int) -> list[int]:
    """Return the wheelsets without which some nodes are not connected any more."""
    # a spanning forest shows few that may be; what the others connect is one node, and the same again with what is left
    while len(wheel):
        may_be = _of_forest(wheel, node, serial, nodes)
        others = ~np.isin(serial[wheel], may_be)
        merged = _labels(wheel[others], node[others], nodes)
        wheel, node = wheel[~others], merged[node[~others]]
        pairs = np.unique(wheel * nodes + node)
        wheel, node = np.divmod(pairs, nodes)
        links = np.bincount(wheel, minlength=len(serial)) > 1
        wheel, node = wheel[links[wheel]], node[links[wheel]]
        if not others.any():
            break
    count = _parts(_labels(wheel, node, nodes), node)
    needed = []
    for number in np.unique(serial[wheel]).tolist():
        others = serial[wheel] != number
        if _parts(_labels(wheel[others], node[others], nodes), node) > count:
            needed.append(number)
    return needed


def _of_forest(wheel: IntArray, node: IntArray, serial: IntArray, nodes: int) -> IntArray:
    most = np.bincount(serial[wheel], minlength=int(serial.max()) + 1)
    cost = np.empty(len(most))
    cost[np.argsort(-most, kind="stable")] = np.arange(1, len(most) + 1)
    size = nodes + len(serial)
    graph = coo_array((cost[serial[wheel]], (nodes + wheel, node)), shape=(size, size))
    tree = minimum_spanning_tree(graph).tocoo()
    ends = np.bincount(np.concatenate([tree.row, tree.col]), minlength=size)[nodes:]
    return np.unique(serial[ends > 1])


def _labels(wheel: IntArray, node: IntArray, nodes: int) -> IntArray:
    size = nodes + (int(wheel.max()) + 1 if len(wheel) else 0)
    graph = coo_array((np.ones(len(wheel)), (nodes + wheel, node)), shape=(size, size))
    return connected_components(graph, directed=False)[1][:nodes].astype(np.int64)


def _parts(labels: IntArray, node: IntArray) -> int:
    return len(np.unique(labels[node]))
