"""Why two high-passed signals are not of one place."""

from __future__ import annotations

from estimation.track.screening.agreement import Agreement
from estimation.track.screening.parameters import ScreeningParameters
from estimation.values.reasons import Reason, ReasonCode


def disagreement(found: Agreement, usual: float, p: ScreeningParameters, other: str) -> Reason | None:
    """Return why two signals do not agree; None where they do."""
    if found.log10_chance > p.log10_chance:
        return Reason(
            ReasonCode.OTHER_SECTION,
            f"not of this section: agrees with {other} no more than by chance"
            f" (correlation {found.correlation:.2f} over {found.samples:.0f} independent samples)",
        )
    factor = found.factor / usual
    if factor < 0.0:
        return Reason(
            ReasonCode.MIRRORED, f"the mirror image of {other}: the axes of its sensors, or its direction, are reversed"
        )
    if not p.least_factor <= factor <= 1.0 / p.least_factor:
        return Reason(ReasonCode.SCALE_DIFFERS, f"its lateral displacement is {factor:.2g} times that of {other}")
    return None
