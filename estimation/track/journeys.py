"""Journeys: the passes of one vehicle on one run over the section."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from estimation.track.passes import Pass
from estimation.values.track import Correction

NANOSECONDS = 1_000_000_000


@dataclass(frozen=True, slots=True)
class PositionParameters:
    """How far positions may be off."""

    largest_offset: float = 45.0  # m, searched both ways
    pause_s: float = 300.0  # a longer pause between windows of a vehicle begins a new journey
    piece: float = 800.0  # m of a pass that is compared at a time
    least_correlation: float = 0.4


Journey = tuple[str, int]  # vehicle, start of its first window, ns


def journeys(passes: Sequence[Pass], parameters: PositionParameters) -> dict[Journey, list[Pass]]:
    """Group passes by vehicle and run."""
    found: dict[Journey, list[Pass]] = {}
    last: dict[str, tuple[Journey, int]] = {}
    for item in sorted(passes, key=lambda p: (p.vehicle, p.start_ns, p.life)):
        end = item.start_ns
        known = last.get(item.vehicle)
        if known is None or end - known[1] > parameters.pause_s * NANOSECONDS:
            journey = (item.vehicle, item.start_ns)
            found[journey] = []
        else:
            journey = known[0]
        found[journey].append(item)
        last[item.vehicle] = (journey, end)
    return found


def apply_correction(passes: Sequence[Pass], correction: Correction) -> list[Pass]:
    """Return the passes at their corrected positions."""
    return [replace(item, at=correction.at(item.at)) for item in passes]
