"""What is known of a conicity against its limit: at 3 mm, and where that is extrapolated at the amplitude reached.

A limit is held at 3 mm (EN 15302). A wheelset that does not move as far is extrapolated; what it does at the largest
amplitude that it reaches is known better, and a conicity over the limit there is a danger whatever lies beyond. The
trend is a smooth curve: the last two points of it, both over the limit, are over it too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from estimation.alerts.rules.rule import WheelsetFacts
from estimation.trend.extrapolation import (
    LEAST_AMPLITUDE,
    LIMIT_AMPLITUDE,
    SAME_AMPLITUDE,
    Extrapolation,
    below_limit,
    conicity_at_limit_amplitude,
    extrapolated,
)
from estimation.trend.trend import probability_above
from estimation.values.quantities import Estimate, Status, with_interval
from estimation.values.reasons import ReasonCode, code_of
from estimation.values.trend import WearTrend

LAST_POINTS = 2  # of a trend: one alone may be an outlier
NOT_BELOW = 0.6  # least probability at 3 mm with which a conicity over the limit at a smaller amplitude is over it


@dataclass(frozen=True, slots=True)
class Against:
    """A conicity against a limit: which one decides, at which amplitude (m), and how probably it is over."""

    conicity: Estimate
    amplitude: float
    probability: float


@dataclass(frozen=True, slots=True)
class LimitState:
    """What is known of the conicity of a wheelset now.

    ``reached`` is that at the largest amplitude covered, where that is below 3 mm and not too small to say anything of
    a limit; ``last`` are the last points of a trend that a limit is held against; ``left_open`` says that the wheelset
    moves as far as a limit is held against it, and its data leave the conicity open.
    """

    conicity: Estimate  # at 3 mm
    reached: Estimate | None = None
    reached_amplitude: float = LIMIT_AMPLITUDE  # m
    last: Sequence[Estimate] = ()
    beyond: Extrapolation | None = None  # how an extrapolated conicity is spread about its mean
    left_open: bool = False

    def at_limit(self, limit: float) -> Against | None:
        """Return the conicity at 3 mm against a limit: of the trend, or of its last points; None where not known."""
        of_trend = self._above(self.conicity, limit)
        if of_trend is None:
            return None
        known = [(self.conicity, of_trend)]
        if len(self.last) == LAST_POINTS:
            points = [(one, self._above(one, limit) or 0.0) for one in self.last]
            known.append(min(points, key=lambda pair: pair[1]))
        conicity, probability = max(known, key=lambda pair: pair[1])
        return Against(conicity, LIMIT_AMPLITUDE, probability)

    def at_reached(self, limit: float) -> Against | None:
        """Return the conicity at the largest amplitude covered against a limit; None where that is 3 mm or unknown."""
        probability = None if self.reached is None else probability_above(self.reached, limit)
        if self.reached is None or probability is None:
            return None
        return Against(self.reached, self.reached_amplitude, probability)

    def against(self, limit: float) -> Against | None:
        """Return the conicity that decides whether the limit is exceeded; None where none does.

        That is the one at 3 mm; at the amplitude reached where that one is over more probably and the one at 3 mm is
        unknown or not rather below. One that is below at a smaller amplitude alone decides nothing.
        """
        at_limit, at_reached = self.at_limit(limit), self.at_reached(limit)
        if at_reached is None or at_reached.probability < NOT_BELOW:
            return at_limit
        if at_limit is None:
            return at_reached
        if at_limit.probability < NOT_BELOW:
            return at_limit
        return max(at_limit, at_reached, key=lambda one: one.probability)

    def _above(self, estimate: Estimate, limit: float) -> float | None:
        """Return the probability above a limit; the std of a trend counts what lies beyond once more in each point."""
        if self.beyond is None or estimate.value is None:
            return probability_above(estimate, limit)
        return replace(self.beyond, value=estimate.value).mixture().above(limit)

    @property
    def extrapolated(self) -> bool:
        """Whether the conicity at 3 mm is extrapolated."""
        return self.reached is not None


def limit_state(facts: WheelsetFacts) -> LimitState | None:
    """Return what is known of the conicity of a wheelset; None without a geometry.

    Args:
        facts: Of one wheelset. The fitted trend says what is at 3 mm, or the current geometry where none is comparable.
    """
    if facts.geometry is None:
        return None
    geometry, record = facts.geometry.geometry, facts.current_trend
    trend = None if record is None or record.trend.not_comparable else record.trend
    fitted = None if trend is None or trend.fitted.status is not Status.ESTIMATED else trend.fitted
    conicity = conicity_at_limit_amplitude(geometry) if fitted is None else fitted
    amplitude = geometry.reported_amplitude
    reaches = LEAST_AMPLITUDE - SAME_AMPLITUDE < amplitude < LIMIT_AMPLITUDE - SAME_AMPLITUDE
    known = reaches and geometry.equivalent_conicity.status is Status.ESTIMATED
    beyond = extrapolated(below_limit(geometry)) if known else None
    return LimitState(
        conicity,
        geometry.equivalent_conicity if known else None,
        amplitude if known else LIMIT_AMPLITUDE,
        () if trend is None or fitted is None else _last(trend),
        beyond,
        any(_is_open(float(at), one) for at, one in zip(geometry.amplitude, geometry.conicity, strict=True)),
    )


def _is_open(amplitude: float, conicity: Estimate) -> bool:
    compared = LEAST_AMPLITUDE - SAME_AMPLITUDE < amplitude < LIMIT_AMPLITUDE + SAME_AMPLITUDE
    return compared and code_of(conicity.reason) is ReasonCode.CONICITY_OPEN


def _last(trend: WearTrend) -> Sequence[Estimate]:
    pairs = zip(trend.value[-LAST_POINTS:].tolist(), trend.std[-LAST_POINTS:].tolist(), strict=True)
    return [with_interval(value, std) for value, std in pairs]
