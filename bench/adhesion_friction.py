"""The friction that passes show, beside the true one: places, stretches that are found, alarms that are false."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from bench.adhesion_stored import StoredPasses
from estimation.adhesion.friction import FrictionParameters, section_adhesion
from estimation.values.arrays import FloatArray, runs
from estimation.values.opinions import SectionAdhesion

LOW = 0.15
WITHIN = 200.0  # m from the start of a stretch within which it is to be found
STEP = 1.0  # m


@dataclass(slots=True)
class FrictionScore:
    """What is found of the friction of one case; plain numbers."""

    cells: list[dict[str, float | None]] = field(default_factory=list)
    stretches: list[tuple[float, float]] = field(default_factory=list)  # true ones that were passed
    found: list[bool] = field(default_factory=list)
    alarms: list[tuple[float, float, float]] = field(default_factory=list)  # begin, end, least friction in it
    left_out: list[str] = field(default_factory=list)  # vehicles and wheelsets that contradict the others


def judge(stored: StoredPasses, parameters: FrictionParameters | None = None) -> FrictionScore:
    """Pool the passes of a case and compare with the truth."""
    found = section_adhesion(stored.section, stored.passes, parameters or FrictionParameters(), stored.length)
    return FrictionScore() if found is None else compare(found, stored)


def compare(found: SectionAdhesion, stored: StoredPasses) -> FrictionScore:
    """Return the friction that was found beside the true one."""
    done = FrictionScore(left_out=[one.wheelset or one.vehicle for one in found.left_out])
    for cell in found.cells:
        along = _along(stored, cell.from_m, cell.to_m)
        done.cells.append(
            {
                "from": cell.from_m,
                "mean": float(along.mean()),
                "least": float(along.min()),
                "value": cell.friction.value,
                "low": cell.friction.low,
                "high": cell.friction.high,
                "at_least": cell.at_least,
                "probability": cell.low_probability,
                "passes": cell.passes,
            }
        )
    passed = [cell.from_m for cell in found.cells if cell.friction.value is not None or cell.at_least]
    if not passed:
        return done
    s = np.arange(max(min(passed), 0.0), min(max(passed), stored.length), STEP)
    friction = np.interp(s, stored.distance, stored.friction)
    for first, behind in runs(friction < LOW):
        begin, end = float(s[first]), float(s[behind - 1])
        done.stretches.append((begin, end))
        reach = min(begin + WITHIN, max(end, begin + STEP))
        done.found.append(any(a <= reach and b >= begin for a, b in found.low_stretches))
    done.alarms = [(a, b, float(_along(stored, a, b).min())) for a, b in found.low_stretches]
    return done


def _along(stored: StoredPasses, begin: float, end: float) -> FloatArray:
    s = np.arange(begin, end + STEP, STEP)
    return np.asarray(np.interp(s, stored.distance, stored.friction))
