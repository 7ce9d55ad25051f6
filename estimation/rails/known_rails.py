"""Sections that are named as known, compared with each other: their rails cannot be as on file where they differ.

Each is taken as unknown in turn, its level held by the others. Where its rails then add to the conicity of the wheel as
designed, or of the fleet's mean wheel, beyond doubt, one of them is not what it is named. Of three or more that is the
one that is furthest from the others; of two nobody knows which, so that neither holds the level.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from estimation.rails.amplitude import at_amplitude
from estimation.rails.parameters import Anchors, RailsParameters
from estimation.values.arrays import FloatArray
from estimation.values.quantities import Estimate
from estimation.values.rails import RailsReference, SectionConicity
from estimation.values.reasons import Reason, ReasonCode

TWO = 2


def confirmed(
    cells: Sequence[SectionConicity], amplitude: FloatArray, anchors: Anchors, parameters: RailsParameters
) -> Anchors:
    """Return the anchors without the sections that contradict the others that are named as known, and why.

    Parameters
    ----------
    cells
        All, in the order of their keys.
    amplitude
        (k,) m, of the cells.
    anchors
        As named.
    parameters
        Of the model.
    """
    held, refused = anchors, dict(anchors.refused)
    while True:
        known = sorted({cell.rail.section for cell in cells} & held.known_rails)
        apart = {section: _apart(section, cells, amplitude, held, parameters) for section in known}
        beyond = {section: one for section, one in apart.items() if one is not None}
        if not beyond:
            return replace(held, refused=refused)
        worst = known if len(known) == TWO else [max(beyond, key=lambda section: abs(beyond[section].value or 0.0))]
        refused |= {section: _reason(section, known, beyond) for section in worst}
        held = replace(held, known_rails=held.known_rails - set(worst))


def _apart(
    section: str, cells: Sequence[SectionConicity], amplitude: FloatArray, anchors: Anchors, parameters: RailsParameters
) -> Estimate | None:
    """Return the excess of a section over the others that are known, where it is beyond doubt; None where it is not.

    For the fleet's mean wheel where nothing follows for that as designed. Of several periods the one that is furthest;
    at the amplitude of the limit, or the largest below that is known.
    """
    others = replace(anchors, known_rails=anchors.known_rails - {section})
    if not others.known_rails:
        return None
    for k in np.flatnonzero(amplitude <= parameters.limit_amplitude + 1e-9)[::-1]:
        rails = at_amplitude(cells, int(k), others, parameters).rails
        own = [one for key, one in rails.items() if key.section == section]
        held = [one for one in own if one.reference is RailsReference.KNOWN_RAILS]
        either = [one.excess if one.excess.value is not None else one.part for one in held]
        found = [one for one in either if one.value is not None]
        if found:
            beyond = [one for one in found if _is_beyond(one, parameters.known_apart)]
            return max(beyond, key=lambda one: abs(one.value or 0.0), default=None)
    return None


def _is_beyond(excess: Estimate, intervals: float) -> bool:
    assert excess.value is not None
    assert excess.low is not None
    return abs(excess.value) > intervals * (excess.value - excess.low)


def _reason(section: str, known: Sequence[str], beyond: Mapping[str, Estimate]) -> Reason:
    others = ", ".join(one for one in known if one != section)
    one = beyond.get(section) or next(iter(beyond.values()))
    text = f"named as known as {others}, but the conicity differs by {abs(one.value or 0.0):.3f} between them"
    return Reason(ReasonCode.KNOWN_RAILS_DIFFER, text)
