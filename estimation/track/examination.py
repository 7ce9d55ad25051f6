"""One window to the passes that it holds, or the reason why it holds none.

A window is looked at by itself: its sensors, its speed, how its positions go with its speed, which way its axes point.
Where the position jumps the passes end; what is on both sides is judged against the rest of the journey later.
"""

from __future__ import annotations

from dataclasses import dataclass

from estimation.motion.checks import check_axis_signs, check_moving, gate, jumps_reason, position_jumps, without_jumps
from estimation.motion.integration import integrate
from estimation.motion.parameters import WindowParameters
from estimation.motion.usable_samples import moving_samples
from estimation.track.passes import Pass, passes
from estimation.track.screening.screen import PassOutcome, PassStatus
from estimation.values.reasons import Reason, ReasonCode, combined
from estimation.values.windows import Window


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
