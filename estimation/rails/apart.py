"""Wheel and rail apart: cells in, amplitude by amplitude what belongs to rails and to wheels out.

The same cells give the same answer in any order.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import compress
from typing import NamedTuple

import numpy as np

from estimation.errors import ParameterError
from estimation.rails.amplitude import NOT_COVERED, NOTHING, Check, at_amplitude, wheel_checks
from estimation.rails.cell import Anchors, CellTable, cell_table, extent, grouped, sections_of, wheelsets_of
from estimation.rails.component import Runs, islands
from estimation.rails.parameters import RailsParameters
from estimation.rails.published import NEXT_TO_JUMP, AtAmplitude, TrendAt, on_rise
from estimation.values.arrays import FloatArray
from estimation.values.opinions import (
    RailKey,
    RailPart,
    RailsApart,
    RailsReference,
    RailTrend,
    SectionConicity,
    WheelKey,
    WheelPart,
)
from estimation.values.quantities import Estimate
from estimation.values.reasons import Reason, ReasonCode

HELD = (RailsReference.KNOWN_RAILS, RailsReference.MEASURED_WHEELS)


class _Witness(NamedTuple):
    is_wheelset: bool
    name: str  # code, or serial


def confirmed(table: CellTable, anchors: Anchors, parameters: RailsParameters) -> Anchors:
    """Return the anchors without those that contradict the others, and why."""
    held, checks = anchors, _all_apart(table, anchors, parameters)
    while True:
        beyond = {witness: check for witness, check in checks.items() if check.ratio > parameters.known_apart}
        if not beyond:
            return held
        order = sorted(beyond, key=lambda witness: (-beyond[witness].ratio, witness))
        together = _connected(order[0], sorted(checks), table, held)
        may_be = [w for place, w in enumerate(order) if place < parameters.tried_wheelsets or not w.is_wheelset]
        tried = [together] if len(together) == parameters.pair_size else [[witness] for witness in may_be]
        without = [held.without(*_reasons(witnesses, together, beyond)) for witnesses in tried]
        remaining = [(some, _all_apart(table, some, parameters)) for some in without]
        held, checks = min(remaining, key=lambda pair: max((check.ratio for check in pair[1].values()), default=0.0))


def _all_apart(table: CellTable, anchors: Anchors, parameters: RailsParameters) -> dict[_Witness, Check]:
    sections = sorted({key.section for key in table.rails if key in anchors.known_rails})
    checks = {
        _Witness(is_wheelset=False, name=code): _section_apart(code, table, anchors, parameters) for code in sections
    }
    for k in range(len(table.amplitude)) if anchors.known_wheels else ():
        for serial, check in wheel_checks(table, k, anchors, parameters).items():
            witness = _Witness(is_wheelset=True, name=serial)
            if witness not in checks or check.ratio > checks[witness].ratio:
                checks[witness] = check
    return checks


def _section_apart(section: str, table: CellTable, anchors: Anchors, parameters: RailsParameters) -> Check:
    """Return the excess of a section over what the others say."""
    # For the fleet's mean wheel where nothing follows for that as designed. Of several periods the one that is
    # furthest; at the amplitude of the limit, or the largest below that is known.
    others = replace(anchors, known_rails=frozenset(key for key in anchors.known_rails if key.section != section))
    if not others.known_rails and not others.known_wheels:
        return NOTHING
    for k in np.flatnonzero(table.amplitude <= parameters.limit_amplitude + parameters.same_amplitude)[::-1]:
        rails = at_amplitude(table, int(k), others, parameters).rails
        periods = [rail for key, rail in rails.items() if key.section == section and key in anchors.known_rails]
        shown = [rail.part if rail.excess.value is None else rail.excess for rail in periods if rail.reference in HELD]
        ends = ((estimate.value, estimate.low) for estimate in shown)
        checks = [Check(value, value - low, np.nan) for value, low in ends if value is not None and low is not None]
        if checks:
            return max(checks, key=lambda check: check.ratio)
    return NOTHING


def _connected(worst: _Witness, witnesses: Sequence[_Witness], table: CellTable, anchors: Anchors) -> list[_Witness]:
    nothing = np.zeros(len(table.rails), np.bool_)
    labels = islands(Runs(table.wheel, table.rail, table.serial, nothing, np.zeros(len(table.wheels), np.bool_)))
    measured = {known_wheel.wheel for known_wheel in anchors.known_wheels}

    def of(witness: _Witness) -> set[int]:
        if not witness.is_wheelset:
            return {int(labels[place]) for place, key in enumerate(table.rails) if key.section == witness.name}
        wheels = [place for place, key in enumerate(table.wheels) if key.wheelset == witness.name and key in measured]
        return set(labels[table.rail[np.isin(table.wheel, wheels)]].tolist())

    return [witness for witness in witnesses if of(witness) & of(worst)]


def _reasons(
    some: Sequence[_Witness], together: Sequence[_Witness], beyond: Mapping[_Witness, Check]
) -> tuple[dict[str, Reason], dict[str, Reason]]:
    most = max(beyond.values(), key=lambda check: check.ratio)
    sections, wheelsets = dict[str, Reason](), dict[str, Reason]()
    for of in some:
        others = ", ".join(witness.name for witness in together if witness != of)
        differs = f"as {others}, but the conicity differs by {abs(beyond.get(of, most).apart):.3f} between them"
        if of.is_wheelset:
            wheelsets[of.name] = Reason(ReasonCode.MEASURED_WHEELS_DIFFER, f"measured, {differs}")
        else:
            sections[of.name] = Reason(ReasonCode.KNOWN_RAILS_DIFFER, f"named as known, {differs}")
    return sections, wheelsets


def rails_apart(
    cells: Sequence[SectionConicity], amplitude: FloatArray, anchors: Anchors, parameters: RailsParameters
) -> RailsApart:
    """Return wheels and rails apart at every amplitude, with intervals, or why they are not.

    Args:
        cells: Each wheelset, interval, section and period once; what belongs to one cell is merged before, as bin
            tables.

    Raises:
        ParameterError: A cell is there twice, or has other amplitudes.
    """
    cells = sorted(cells, key=lambda cell: cell.key)
    for cell, before in zip(cells, [None, *cells], strict=False):
        if before is not None and cell.key == before.key:
            raise ParameterError(f"two cells of {cell.wheel.wheelset} on {cell.rail.section}", field="cells")
        if not np.array_equal(cell.amplitude, amplitude):
            raise ParameterError(f"cell of {cell.wheel.wheelset}: other amplitudes", field="amplitude")
    table = cell_table(cells, amplitude)
    held = confirmed(table, anchors, parameters)
    levels = [at_amplitude(table, k, held, parameters) for k in range(len(amplitude))]
    _refuse_rises(levels, amplitude, parameters.steepest, parameters)
    of_rails, of_wheels = grouped((cell.rail, cell) for cell in cells), grouped((cell.wheel, cell) for cell in cells)
    trends, no_trends = _trends(levels, amplitude, anchors, parameters)
    return RailsApart(
        amplitude=amplitude,
        rails=tuple(_rail_part(key, of_rails[key], levels) for key in table.rails),
        wheels=tuple(_wheel_part(key, of_wheels[key], levels) for key in table.wheels),
        trends=trends,
        no_trends=no_trends,
        interaction=np.array([level.interaction for level in levels]),
        refused=held.refused,
        refused_wheels=held.refused_wheels,
    )


def _refuse_rises(
    levels: Sequence[AtAmplitude], amplitude: FloatArray, steepest: float, parameters: RailsParameters
) -> None:
    """Take back what is said of the wheel as designed where its conicity, as found on some rails, is on a rise."""
    # the trend of the section goes with it
    keys = sorted({key for level in levels for key in level.rails})
    for key in keys:
        curve = np.array([level.rails[key].solved for level in levels])
        rising = on_rise(curve, amplitude, steepest, parameters)
        for level in compress(levels, rising):
            rail = level.rails[key]
            if rail.reference_wheel.value is not None:
                nothing = Estimate.unknown(NEXT_TO_JUMP, rail.reference_wheel.count)
                level.rails[key] = replace(rail, reference_wheel=nothing, excess=nothing)
                level.trends[key.section] = TrendAt(Estimate.unknown(NEXT_TO_JUMP))


def _rail_part(key: RailKey, cells: Sequence[SectionConicity], levels: Sequence[AtAmplitude]) -> RailPart:
    published = [level.rails[key] for level in levels]
    return RailPart(
        rail=key,
        reference=_strongest([rail.reference for rail in published]),
        part=tuple(rail.part for rail in published),
        reference_wheel=tuple(rail.reference_wheel for rail in published),
        excess=tuple(rail.excess for rail in published),
        wheelsets=wheelsets_of(cells),
        **extent(cells),
    )


def _wheel_part(key: WheelKey, cells: Sequence[SectionConicity], levels: Sequence[AtAmplitude]) -> WheelPart:
    published = [level.wheels[key] for level in levels]
    return WheelPart(
        wheel=key,
        reference=_strongest([wheel.reference for wheel in published]),
        conicity=tuple(wheel.conicity for wheel in published),
        sections=sections_of(cells),
        **extent(cells),
    )


def _strongest(references: Sequence[RailsReference | None]) -> RailsReference | None:
    return next((reference for reference in RailsReference if reference in references), None)


def _trends(
    levels: Sequence[AtAmplitude], amplitudes: FloatArray, anchors: Anchors, parameters: RailsParameters
) -> tuple[dict[str, RailTrend], dict[str, Reason]]:
    # of the others why there is none, at the largest amplitude at which that is said; where the excess is not on a line
    # at one amplitude, that it is at a smaller one says nothing
    trends: dict[str, RailTrend] = {}
    why: dict[str, Reason] = {}
    for amplitude, level in reversed(list(zip(amplitudes, levels, strict=True))):
        if amplitude > parameters.limit_amplitude + parameters.same_amplitude:
            continue
        for section in {key.section for key in level.rails} - trends.keys():
            here = level.trends.get(section, TrendAt(Estimate.unknown(NOT_COVERED)))
            if here.per_year.reason is not None:
                why.setdefault(section, here.per_year.reason)
            elif section not in why or why[section].code is not ReasonCode.TREND_NOT_A_LINE:
                trend = RailTrend(here.per_year, float(amplitude), here.periods)
                trends[section] = trend.with_tonnage(anchors.tonnage.get(section))
    return trends, {section: reason for section, reason in why.items() if section not in trends}


def reported(
    part: tuple[Estimate, ...], amplitude: FloatArray, parameters: RailsParameters
) -> tuple[Estimate, float] | None:
    """Return the estimate at the largest amplitude, up to that of the limit, at which there is one; None for none."""
    most = parameters.limit_amplitude + parameters.same_amplitude
    pairs = zip(reversed(part), amplitude[::-1].tolist(), strict=True)
    return next(((estimate, at) for estimate, at in pairs if estimate.value is not None and at <= most), None)


def exceeds(excess: Estimate, limit: float) -> bool:
    """Return whether an excess is beyond a limit, to either side, and its interval leaves no doubt of the side."""
    if excess.value is None or excess.low is None or excess.high is None:
        return False
    return abs(excess.value) > limit and not excess.low <= 0.0 <= excess.high
