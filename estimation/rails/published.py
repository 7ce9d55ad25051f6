"""What of the solution of connected cells may be published: rails, wheels, and trends of sections.

Where the wheel as designed is next to a contact jump, nothing follows for it from worn wheels. There the conicity
changes steeply over the amplitude, and another gauge or wear of the rails moves the jump over the amplitude, which is
no matter of adding a number. On the rails as on file the curve is known exactly, and any steep change counts. As found
on worn rails a rise counts: where the motion begins to reach a jump, the conicity rises within a fraction of a
millimetre; behind it it falls as the inverse of the amplitude, and that of worn wheels falls likewise.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, field

import numpy as np
from scipy.special import fdtri

from estimation.geometry.parameters import PRIORS
from estimation.rails.cell import ReferenceWheel
from estimation.rails.component import Component
from estimation.rails.parameters import RailsParameters
from estimation.rails.two_way import Parted, part
from estimation.values.arrays import BoolArray, FloatArray
from estimation.values.opinions import RailKey, RailsReference, WheelKey
from estimation.values.quantities import Estimate, Status, with_interval
from estimation.values.reasons import Reason, ReasonCode

PARAMETERS = 2  # of a line


@dataclass(frozen=True, slots=True)
class TrendAt:
    """The trend of a section at one amplitude, 1/year, or why there is none."""

    per_year: Estimate
    periods: int = 0


@dataclass(frozen=True, slots=True)
class Line:
    """A line through correlated values."""

    slope: float
    std: float  # of the slope
    squares: float  # weighted, of what is left
    freedom: int  # how many are left

    def fits(self, groups: float, doubted_share: float) -> bool:
        """Whether the values are on a line, as far as their errors say."""
        if self.freedom < 1:
            return True
        return self.squares <= self.freedom * float(fdtri(self.freedom, max(groups, 1.0), doubted_share))


def line(at: FloatArray, value: FloatArray, covariance: FloatArray) -> Line:
    """Return the line through correlated values."""
    columns = np.column_stack([np.ones(len(at)), at - at.mean()])
    weighted = np.linalg.solve(covariance, columns)
    matrix = columns.T @ weighted
    coefficients = np.linalg.solve(matrix, weighted.T @ value)
    residual = value - columns @ coefficients
    squares = float(residual @ np.linalg.solve(covariance, residual))
    return Line(float(coefficients[1]), float(np.sqrt(np.linalg.inv(matrix)[1, 1])), squares, len(at) - PARAMETERS)


AS_ON_FILE = Reason(ReasonCode.RAILS_ARE_REFERENCE, "the section is named as known: nothing is measured of its rails")


def next_to_jump(curve: FloatArray, amplitude: FloatArray, most: float, parameters: RailsParameters) -> BoolArray:
    """Return where (k,) a conicity changes by more than ``most`` within 0.25 mm of amplitude, to either side."""
    return np.asarray((np.abs(_changes(curve, amplitude, parameters)) > most).any(axis=1))


def on_rise(curve: FloatArray, amplitude: FloatArray, most: float, parameters: RailsParameters) -> BoolArray:
    """Return where (k,) a conicity rises by more than ``most`` within 0.25 mm of amplitude, before or behind."""
    return np.asarray((_changes(curve, amplitude, parameters) > most).any(axis=1))


def _changes(curve: FloatArray, amplitude: FloatArray, parameters: RailsParameters) -> FloatArray:
    """Return by how much (k, k) the conicity grows from the smaller to the larger of two amplitudes that are near."""
    apart = amplitude[:, None] - amplitude[None, :]
    near = np.abs(apart) <= parameters.slope_reach + parameters.same_amplitude
    grown = np.sign(apart) * (curve[:, None] - curve[None, :])
    return np.where(near & np.isfinite(grown), grown, 0.0)


NO_REFERENCE_WHEEL = Reason(ReasonCode.PROFILE_UNKNOWN, "the conicity of the wheel as designed is not known here")
NEXT_TO_JUMP = Reason(ReasonCode.CONTACT_JUMP_NEAR, "the wheel as designed is next to a contact jump at this amplitude")
NOT_CONVERGED = Reason(ReasonCode.NOT_CONVERGED, "wheels and rails were not parted: the iteration did not converge")


@dataclass(frozen=True, slots=True)
class RailAt:
    """What is published of rails at one amplitude."""

    reference: RailsReference | None
    part: Estimate
    reference_wheel: Estimate
    excess: Estimate
    solved: float = float("nan")  # conicity of the wheel as designed, published or not; NaN on known rails

    @staticmethod
    def unknown(reason: Reason, solved: float = float("nan")) -> RailAt:
        """Return that nothing is known, with the reason."""
        nothing = Estimate.unknown(reason)
        return RailAt(None, nothing, nothing, nothing, solved)


@dataclass(frozen=True, slots=True)
class WheelAt:
    """What is published of a wheelset at one amplitude."""

    reference: RailsReference | None
    conicity: Estimate


@dataclass(slots=True)
class AtAmplitude:
    """What is published at one amplitude, of a component or of all."""

    rails: dict[RailKey, RailAt] = field(default_factory=dict)
    wheels: dict[WheelKey, WheelAt] = field(default_factory=dict)
    trends: dict[str, TrendAt] = field(default_factory=dict)  # of sections with rails that were parted, or why not
    interaction: float = float("nan")  # of the component with most cells


def parted(component: Component, wheel: ReferenceWheel, parameters: RailsParameters) -> AtAmplitude:
    """Return what may be published of connected cells."""
    solution = part(component.two_way, parameters)
    refused = refusal(component, solution, wheel, parameters)
    if refused is not None:
        solved, _ = solution.reference_wheel(float(wheel.on_reference[component.k]))
        return AtAmplitude(
            {key: RailAt.unknown(refused, value) for key, value in zip(component.rails, solved.tolist(), strict=True)},
            {key: WheelAt(None, Estimate.unknown(refused)) for key in component.wheels},
            {key.section: TrendAt(Estimate.unknown(refused)) for key in component.rails},
            interaction=solution.interaction,
        )
    publisher = _Publisher(component, solution, wheel, parameters)
    return AtAmplitude(publisher.rails(), publisher.wheels(), publisher.trends(), solution.interaction)


def refusal(
    component: Component, solution: Parted, wheel: ReferenceWheel, parameters: RailsParameters
) -> Reason | None:
    """Return why nothing of a solution is published; None where it is."""
    if not solution.converged:
        return NOT_CONVERGED
    if _is_steep(component, wheel.on_reference, parameters):
        return NEXT_TO_JUMP
    if solution.interaction > parameters.most_interaction:
        text = f"neither wheel nor rail explains {solution.interaction:.3f} of the conicities at this amplitude"
        return Reason(ReasonCode.RAILS_INTERACT, text)
    return None


class _Publisher:
    """Turns a solution into estimates.

    Systematic errors are those that residuals do not show. What all cells share (creep, stiffness, a sensor's scale) is
    in proportion to the conicity: of a difference of rails it leaves as much as that is of the conicity, of rails whose
    level wheels hold all of it. The scale of y - d that the alignment of a section leaves open belongs to the section,
    and looks like its rails.
    """

    def __init__(
        self, component: Component, solution: Parted, wheel: ReferenceWheel, parameters: RailsParameters
    ) -> None:
        self.component, self.solution, self.wheel, self.parameters = component, solution, wheel, parameters
        self.shared = component.shared(parameters.least_conicity)  # relative, what is systematic in all cells
        # relative, of the scale of y - d: (s,) on each section, and of what is the reference
        self.scale = component.by_rail(component.table.scale[component.cells])
        self.scale_of_reference = _scale_of_reference(component, self.scale)
        self.design = float(wheel.on_reference[component.k])
        # conicity (s,) of the wheel as designed with its covariance, and by how much it is outside those that ran there
        self.value, self.covariance = solution.reference_wheel(self.design)
        lowest, highest = np.full((2, len(component.rail)), [[np.inf], [-np.inf]])
        np.minimum.at(lowest, component.two_way.rail, solution.wheel[component.two_way.wheel])
        np.maximum.at(highest, component.two_way.rail, solution.wheel[component.two_way.wheel])
        self.apart = np.maximum(lowest - self.design, self.design - highest)
        self.mean = abs(solution.centre)
        self.groups = 1 + max(1, int(solution.freedom))

    def rails(self) -> dict[RailKey, RailAt]:
        component = self.component
        two_way, windows = component.two_way, component.table.windows[component.cells]
        count = np.bincount(two_way.rail, windows, minlength=len(component.rail))
        return {
            key: self._of_known(key, windows) if known else self._of_rail(place, key, windows)
            for place, (key, known, windows) in enumerate(
                zip(component.rails, two_way.known_rail.tolist(), count.tolist(), strict=True)
            )
        }

    def wheels(self) -> dict[WheelKey, WheelAt]:
        component = self.component
        windows = component.table.windows[component.cells]
        count = np.bincount(component.two_way.wheel, windows, minlength=len(component.wheel))
        if not component.two_way.anchored:
            return {
                key: WheelAt(RailsReference.MEAN, Estimate.unknown(component.level_open, of_wheel))
                for key, of_wheel in zip(component.wheels, count.tolist(), strict=True)
            }
        systematic, wheels = self._systematic_of_wheels(), {}
        for place, key in enumerate(component.wheels):
            theta, std = float(self.solution.wheel[place]), float(np.sqrt(self.solution.wheel_variance[place]))
            estimate = self._published(theta, std, float(systematic[place]), float(count[place]))
            wheels[key] = WheelAt(self._reference(self.solution.wheel_moved[place]), estimate)
        return wheels

    def trends(self) -> dict[str, TrendAt]:
        """Return the trend of the reference wheel's conicity, 1/year, of every section, or why there is none."""
        of_section: defaultdict[str, list[int]] = defaultdict(list)
        for place, key in enumerate(self.component.rails):
            of_section[key.section].append(place)
        return {section: self._trend(section, places) for section, places in of_section.items()}

    def _trend(self, section: str, places: list[int]) -> TrendAt:
        unknown = [place for place in places if not self.component.two_way.known_rail[place]]
        if not unknown:
            return TrendAt(Estimate.unknown(AS_ON_FILE))
        why = {place: self._no_conclusion(place, section) for place in unknown}
        concluding = [place for place in unknown if why[place] is None]
        count = len(concluding)
        if count < self.parameters.least_periods:
            text = f"{count} period{'s' * (count != 1)} of the section {'are' if count != 1 else 'is'} known, "
            few = Reason(ReasonCode.TOO_FEW_PERIODS, f"{text}{self.parameters.least_periods} are needed")
            return TrendAt(Estimate.unknown(why[unknown[-1]] or few))
        years = self.component.by_rail(self.component.table.years[self.component.cells])
        covariance = self.covariance[np.ix_(concluding, concluding)] + self.solution.interaction**2 * np.eye(count)
        course = line(years[concluding], self.value[concluding], covariance)
        if not course.fits(self.solution.freedom, self.parameters.doubted_share):
            text = "is not on a line: the rails were ground or replaced, or wear unevenly"
            bent = Reason(ReasonCode.TREND_NOT_A_LINE, f"the excess of {count} periods {text}")
            return TrendAt(Estimate.unknown(bent))
        systematic = self.shared * abs(course.slope)
        return TrendAt(with_interval(course.slope, course.std, systematic, self.groups, float(count)), count)

    def _of_rail(self, place: int, key: RailKey, windows: float) -> RailAt:
        reference, rho = self._reference(self.solution.rail_moved[place]), float(self.solution.rail[place])
        std = float(np.sqrt(self.solution.covariance[place, place]))
        part = self._published(rho, std, self._systematic(place, abs(rho)), windows)
        value = float(self.value[place])
        refused = self._no_conclusion(place, key.section)
        if refused is not None:
            nothing = Estimate.unknown(refused, windows)
            return RailAt(reference, part, nothing, nothing, value)
        std = float(np.sqrt(self.covariance[place, place] + self.solution.interaction**2))
        change = abs(value - self.design) + abs(float(self.solution.slope[place])) * self.mean
        systematic = self._systematic(place, change)
        whole = self._published(value, std, systematic, windows)
        on_file = float(self.wheel.of(key.section)[self.component.k])
        if not np.isfinite(on_file):
            return RailAt(reference, part, whole, Estimate.unknown(NO_REFERENCE_WHEEL, windows), value)
        excess = self._published(value - on_file, std, systematic, windows)
        return RailAt(reference, part, whole, excess, value)

    def _of_known(self, key: RailKey, windows: float) -> RailAt:
        reference, none = RailsReference.KNOWN_RAILS, _exactly(0.0, windows)
        here, on_file = self.design, float(self.wheel.of(key.section)[self.component.k])
        if not np.isfinite(here) or not np.isfinite(on_file):
            unknown = Estimate.unknown(NO_REFERENCE_WHEEL, windows)
            return RailAt(reference, none, unknown, unknown)
        return RailAt(reference, none, _exactly(here, windows), _exactly(here - on_file, windows))

    def _published(self, value: float, sampled: float, systematic: float, windows: float) -> Estimate:
        estimate = with_interval(value, sampled, systematic, self.groups, windows)
        if estimate.std is not None and estimate.std <= PRIORS.largest_conicity_std:
            return estimate
        text = f"the data leave the conicity open by {estimate.std:.2f}"
        return Estimate.unknown(Reason(ReasonCode.CONICITY_OPEN, text), windows)

    def _no_conclusion(self, place: int, section: str) -> Reason | None:
        if not self.component.two_way.anchored:
            return self.component.level_open
        if not np.isfinite(self.design):
            return NO_REFERENCE_WHEEL
        if _is_steep(self.component, self.wheel.of(section), self.parameters):
            return NEXT_TO_JUMP
        if self.apart[place] <= self.parameters.farthest:
            return None
        text = "the conicity of the wheel as designed is outside that of the wheels that run there"
        return Reason(ReasonCode.REFERENCE_WHEEL_APART, f"{text} by {self.apart[place]:.3f}")

    def _reference(self, moved: float) -> RailsReference:
        if not self.component.two_way.anchored:
            return RailsReference.MEAN
        by_wheels = abs(moved) > self.parameters.moved_share or not self.component.two_way.known_rail.any()
        return RailsReference.MEASURED_WHEELS if by_wheels else RailsReference.KNOWN_RAILS

    def _systematic(self, place: int, change: float) -> float:
        """Return the systematic std of a difference of rails that is as large as ``change``."""
        wheels = min(abs(float(self.solution.rail_moved[place])), 1.0)
        level = wheels * self.mean + (1.0 - wheels) * change
        of_reference = (1.0 - wheels) * self.scale_of_reference
        return float(np.hypot(self.shared * level, np.hypot(self.scale[place], of_reference) * self.mean))

    def _systematic_of_wheels(self) -> FloatArray:
        theta, known = self.solution.wheel, np.isfinite(self.component.two_way.known_value)
        wheels = np.clip(np.abs(self.solution.wheel_moved), 0.0, 1.0)
        by_wheels = np.abs(theta - float(theta[known].mean())) if known.any() else np.zeros(len(theta))
        of_rails = np.hypot(self.shared, self.scale_of_reference) * np.abs(theta)
        return np.asarray(wheels * self.shared * by_wheels + (1.0 - wheels) * of_rails)


def _scale_of_reference(component: Component, scale: FloatArray) -> float:
    """Return the scale of the mean of what is the reference; what wheels hold has none."""
    two_way = component.two_way
    if two_way.known_rail.any():
        scale = scale[two_way.known_rail]
    elif two_way.anchored:
        return 0.0
    return float(np.sqrt((scale**2).sum()) / len(scale))


def _is_steep(component: Component, curve: FloatArray, parameters: RailsParameters) -> bool:
    return bool(next_to_jump(curve, component.table.amplitude, parameters.steepest, parameters)[component.k])


def _exactly(value: float, windows: float) -> Estimate:
    return Estimate(value, 0.0, value, value, float(windows), Status.ESTIMATED)
