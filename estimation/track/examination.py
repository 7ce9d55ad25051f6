"""One window to the passes that it holds, or the reason why it holds none.

A window is looked at by itself: its sensors, its speed, how its positions go with its speed, which way its axes point.
Where the position jumps the passes end; what is on both sides is judged against the rest of the journey later.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np

from estimation.motion.checks import (
    check_axis_signs,
    check_moving,
    gate,
    jumps_reason,
    moving_samples,
    position_jumps,
    without_jumps,
)
from estimation.motion.integration import integrate
from estimation.motion.parameters import WindowParameters
from estimation.track.passes import Pass, passes
from estimation.track.screening.screen import PassOutcome, PassStatus
from estimation.values.reasons import Reason, ReasonCode, combined
from estimation.values.windows import ACCELERATIONS, Hunting, TurnBlows, Window, WindowQuality


@dataclass(frozen=True, slots=True)
class Examined:
    """The passes of a window, and what became of it."""

    passes: tuple[Pass, ...]
    outcome: PassOutcome


def examine(window: Window, parameters: WindowParameters, *, mounted_reversed: bool = False) -> Examined:
    """Return the passes of a window along its section, with the reason where there is none or not all of it is used.

    Args:
        mounted_reversed: The wheelset's left wheel is on the vehicle's right-hand side.
    """
    refusal = gate(window.quality, window.track_section, parameters.gates) or check_moving(window, parameters.signals)
    if refusal is not None:
        return _examined(window, (), refusal)
    integrated = integrate(window, moving_samples(window, parameters.signals), parameters.signals)
    jumps = position_jumps(integrated)
    if jumps:
        window = without_jumps(window, jumps)
        integrated = integrate(window, moving_samples(window, parameters.signals), parameters.signals)
    found = passes(
        window, parameters.vehicle, parameters.signals, mounted_reversed=mounted_reversed, integrated=integrated
    )
    if not found:
        least = f"no uninterrupted run of {parameters.signals.shortest_segment_s:g} s in one direction"
        return _examined(window, (), combined([jumps_reason(jumps), Reason(ReasonCode.INTERRUPTED, least)]))
    refusal = check_axis_signs(integrated)
    if refusal is not None:
        return _examined(window, (), refusal)
    return _examined(window, tuple(found), jumps_reason(jumps))


def _examined(window: Window, found: tuple[Pass, ...], reason: Reason | None) -> Examined:
    status = PassStatus.USED if found else PassStatus.REFUSED
    return Examined(found, PassOutcome(window.wheelset, window.vehicle, window.start_ns, status, reason))


Item = TypeVar("Item")
MOST = 4  # windows; the pass of a longer run is cut, so that a window that comes late changes little


def following(items: Sequence[Item], keys: Sequence[tuple[Hashable, int, int]], most: int = MOST) -> list[list[Item]]:
    """Return the items in groups that follow each other without a break.

    Args:
        keys: Of each item: what it must share with the one before, its start and its end, ns.
    """
    groups: list[list[Item]] = []
    last: tuple[Hashable, int] | None = None
    for number in sorted(range(len(items)), key=lambda i: (str(keys[i][0]), keys[i][1])):
        shared, start, end = keys[number]
        if last != (shared, start) or len(groups[-1]) == most:
            groups.append([])
        groups[-1].append(items[number])
        last = shared, end
    return groups


def joined(windows: Sequence[Window]) -> Window:
    """Return windows that follow each other as one; the quality is the worst of each measure, shares are means.

    Args:
        windows: One or more, in order of time, each beginning where the one before ends.
    """
    first = windows[0]
    if len(windows) == 1:
        return first
    arrays: dict[str, Any] = {
        name: np.concatenate([getattr(window, name) for window in windows])
        for name in (*ACCELERATIONS, "speed", "distance", "valid")
    }
    frame = [window.frame_yaw_acceleration for window in windows]
    known = [part for part in frame if part is not None]
    none = [np.zeros(len(window.valid), np.bool_) for window in windows]
    bridged = [part if window.bridged is None else window.bridged for part, window in zip(none, windows, strict=True)]
    return replace(
        first,
        length_ns=sum(window.length_ns for window in windows),
        quality=_quality([window.quality for window in windows]),
        frame_yaw_acceleration=np.concatenate(known) if len(known) == len(frame) else None,
        bridged=np.concatenate(bridged) if any(part.any() for part in bridged) else None,
        **arrays,
    )


def _quality(parts: Sequence[WindowQuality]) -> WindowQuality:
    return WindowQuality(
        coverage=float(np.mean([part.coverage for part in parts])),
        longest_gap_s=max(part.longest_gap_s for part in parts),
        gaps=sum(part.gaps for part in parts),
        clipped=float(np.mean([part.clipped for part in parts])),
        invalid=float(np.mean([part.invalid for part in parts])),
        speed_min_m_s=min(part.speed_min_m_s for part in parts),
        speed_max_m_s=max(part.speed_max_m_s for part in parts),
        position_quality=min(part.position_quality for part in parts),
        sensor_fault=any(part.sensor_fault for part in parts),
        hunting=_hunting([part.hunting for part in parts]),
        blows=_blows([part.blows for part in parts]),
    )


def _hunting(parts: Sequence[Hunting]) -> Hunting:
    most = max(parts, key=lambda part: part.share)
    return replace(most, share=float(np.mean([part.share for part in parts])))


def _blows(parts: Sequence[TurnBlows]) -> TurnBlows:
    most = max(parts, key=lambda part: part.share)
    return replace(most, share=float(np.mean([part.share for part in parts])))
