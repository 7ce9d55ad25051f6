"""Wheel and rail apart at one amplitude: which cells are connected, and what holds their level."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from estimation.rails.component import Component, RailAt, WheelAt, parted
from estimation.rails.parameters import Anchors, RailsParameters
from estimation.values.quantities import Estimate
from estimation.values.rails import KnownWheel, RailKey, SectionConicity, WheelKey
from estimation.values.reasons import Reason, ReasonCode

NOT_COVERED = Reason(ReasonCode.AMPLITUDE_NOT_COVERED, "no wheelset has moved as far as this amplitude there")
NOT_CONNECTED = Reason(
    ReasonCode.RAILS_NOT_CONNECTED, "no wheelset that runs there runs on another section at this amplitude"
)


@dataclass(slots=True)
class AtAmplitude:
    """What is published at one amplitude."""

    rails: dict[RailKey, RailAt] = field(default_factory=dict)
    wheels: dict[WheelKey, WheelAt] = field(default_factory=dict)
    trends: dict[str, tuple[Estimate, int]] = field(default_factory=dict)
    interaction: float = float("nan")  # of the component with most cells


def at_amplitude(
    cells: Sequence[SectionConicity], k: int, anchors: Anchors, parameters: RailsParameters
) -> AtAmplitude:
    """Return what is published at an amplitude, for every wheel and every rail that has cells.

    Parameters
    ----------
    cells
        All, in the order of their keys.
    k
        Number of the amplitude.
    anchors
        What holds the level.
    parameters
        Of the model.
    """
    given = [cell for cell in cells if np.isfinite([cell.conicity[k], cell.sampled[k], cell.systematic[k]]).all()]
    known = {one.wheel: one for one in anchors.known_wheels if np.isfinite([one.conicity[k], one.std[k]]).all()}
    kept, refused = _supported(given, known, anchors.known_rails, parameters.least_wheelsets)
    found = AtAmplitude()
    for cell in cells:
        why = refused.get(cell.rail, NOT_COVERED)
        found.rails[cell.rail] = RailAt.unknown(why)
        if found.wheels.get(cell.wheel) is None or cell in given:
            found.wheels[cell.wheel] = WheelAt.unknown(why)
    most = 0
    for component in _components(kept, k, known, anchors):
        answer = parted(component, anchors.wheel, parameters)
        found.rails.update(answer.rails)
        found.wheels.update(answer.wheels)
        found.trends.update(answer.trends)
        if len(component.cells) > most:
            most, found.interaction = len(component.cells), answer.interaction
    return found


def _supported(
    cells: Sequence[SectionConicity], known: Mapping[WheelKey, KnownWheel], known_rails: frozenset[str], least: int
) -> tuple[list[SectionConicity], dict[RailKey, Reason]]:
    """Return the cells on rails that enough wheelsets connect to others, and why the other rails are refused.

    What is refused connects nothing any more, so that others may follow.
    """
    kept, refused = list(cells), dict[RailKey, Reason]()
    while True:
        linking = _linking(kept, known, known_rails)
        weak = {key for key, serials in linking.items() if len(serials) < least and key.section not in known_rails}
        if not weak:
            return kept, refused
        for key in weak:
            count = len(linking[key])
            text = f"{count} wheelset{'s' * (count != 1)} connect the section to others, {least} are needed"
            refused[key] = NOT_CONNECTED if count == 0 else Reason(ReasonCode.TOO_FEW_WHEELSETS, text)
        kept = [cell for cell in kept if cell.rail not in weak]


def _linking(
    cells: Sequence[SectionConicity], known: Mapping[WheelKey, KnownWheel], known_rails: frozenset[str]
) -> dict[RailKey, set[str]]:
    """Return by rails the serials of wheelsets that connect them to others: on other rails too, or known themselves."""
    places: defaultdict[WheelKey, set[RailKey | str]] = defaultdict(set)
    for cell in cells:
        places[cell.wheel].add(_node(cell.rail, known_rails))
    linking: dict[RailKey, set[str]] = {cell.rail: set() for cell in cells}
    for cell in cells:
        if len(places[cell.wheel]) > 1 or cell.wheel in known:
            linking[cell.rail].add(cell.wheel.wheelset)
    return linking


def _node(rail: RailKey, known_rails: frozenset[str]) -> RailKey | str:
    """Return what stands for rails in the graph; all that are known are one."""
    return "" if rail.section in known_rails else rail


def _components(
    cells: Sequence[SectionConicity], k: int, known: Mapping[WheelKey, KnownWheel], anchors: Anchors
) -> list[Component]:
    """Return the cells that are connected; all that is known counts as connected, for it is compared with one thing."""
    wheels, rails = sorted({cell.wheel for cell in cells}), sorted({cell.rail for cell in cells})
    if not cells:
        return []
    nodes: list[WheelKey | RailKey] = [*wheels, *rails]
    numbers = {key: 1 + place for place, key in enumerate(nodes)}
    pairs = [(numbers[cell.wheel], numbers[cell.rail]) for cell in cells]
    pairs += [(0, numbers[key]) for key in rails if key.section in anchors.known_rails]
    pairs += [(0, numbers[key]) for key in wheels if key in known]
    first, second = np.array(pairs).T
    graph = coo_array((np.ones(len(pairs)), (first, second)), shape=(len(numbers) + 1,) * 2)
    _, label = connected_components(graph, directed=False)
    found: defaultdict[int, list[SectionConicity]] = defaultdict(list)
    for cell in cells:
        found[int(label[numbers[cell.wheel]])].append(cell)
    return [
        Component(
            tuple(own),
            k,
            anchors.known_rails,
            {cell.wheel: known[cell.wheel] for cell in own if cell.wheel in known},
            anchors.level_open,
        )
        for own in found.values()
    ]
