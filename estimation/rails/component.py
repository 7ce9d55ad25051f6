"""Cells that wheelsets connect: solved, and what of the solution may be published."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from estimation.geometry.conicity import LARGEST_STD
from estimation.rails.contact_jumps import next_to_jump
from estimation.rails.parameters import RailsParameters, ReferenceWheel
from estimation.rails.two_way import Parted, TwoWay, part
from estimation.values.arrays import FloatArray
from estimation.values.intervals import with_interval
from estimation.values.quantities import Estimate, Status
from estimation.values.rails import KnownWheel, RailKey, RailsReference, SectionConicity, WheelKey
from estimation.values.reasons import Reason, ReasonCode

NS_PER_YEAR = 365.25 * 86_400e9
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
    wheelsets: int
    solved: float = float("nan")  # conicity of the wheel as designed, published or not; NaN on known rails

    @staticmethod
    def unknown(reason: Reason, solved: float = float("nan")) -> RailAt:
        """Return that nothing is known, with the reason."""
        nothing = Estimate.unknown(reason)
        return RailAt(None, nothing, nothing, nothing, 0, solved)

    def without_reference_wheel(self, reason: Reason) -> RailAt:
        """Return the same without the wheel as designed, for which nothing follows."""
        nothing = Estimate.unknown(reason, self.reference_wheel.count)
        return replace(self, reference_wheel=nothing, excess=nothing)


@dataclass(frozen=True, slots=True)
class WheelAt:
    """What is published of a wheelset at one amplitude."""

    reference: RailsReference | None
    conicity: Estimate

    @staticmethod
    def unknown(reason: Reason) -> WheelAt:
        """Return that nothing is known, with the reason."""
        return WheelAt(None, Estimate.unknown(reason))


@dataclass(frozen=True, slots=True, eq=False)
class Component:
    """Cells that are connected, at one amplitude."""

    cells: tuple[SectionConicity, ...]
    k: int  # number of the amplitude
    known_rails: frozenset[str]
    known_wheels: Mapping[WheelKey, KnownWheel]
    level_open: Reason  # what is said where nothing holds the level

    @property
    def wheels(self) -> list[WheelKey]:
        """The wheels, in the order in which they are solved."""
        return sorted({cell.wheel for cell in self.cells})

    @property
    def rails(self) -> list[RailKey]:
        """The rails, in the order in which they are solved."""
        return sorted({cell.rail for cell in self.cells})

    @property
    def reference(self) -> RailsReference:
        """What holds the level."""
        if any(key.section in self.known_rails for key in self.rails):
            return RailsReference.KNOWN_RAILS
        return RailsReference.MEASURED_WHEELS if self.known_wheels else RailsReference.MEAN

    def two_way(self) -> TwoWay:
        """Return the cells as arrays."""
        wheels, rails = self.wheels, self.rails
        of_wheel = {key: place for place, key in enumerate(wheels)}
        of_rail = {key: place for place, key in enumerate(rails)}
        nan = np.full(len(wheels), np.nan)
        value, variance = nan.copy(), nan.copy()
        for key, known in self.known_wheels.items():
            value[of_wheel[key]], variance[of_wheel[key]] = known.conicity[self.k], known.std[self.k] ** 2
        return TwoWay(
            wheel=np.array([of_wheel[cell.wheel] for cell in self.cells], np.int64),
            rail=np.array([of_rail[cell.rail] for cell in self.cells], np.int64),
            value=np.array([cell.conicity[self.k] for cell in self.cells]),
            variance=np.array([cell.sampled[self.k] ** 2 for cell in self.cells]),
            known_rail=np.array([key.section in self.known_rails for key in rails]),
            known_value=value,
            known_variance=variance,
        )


@dataclass(slots=True)
class Answer:
    """What is published of a component."""

    rails: dict[RailKey, RailAt] = field(default_factory=dict)
    wheels: dict[WheelKey, WheelAt] = field(default_factory=dict)
    trends: dict[str, tuple[Estimate, int]] = field(default_factory=dict)
    interaction: float = float("nan")


def parted(component: Component, wheel: ReferenceWheel, parameters: RailsParameters) -> Answer:
    """Return what may be published of connected cells.

    Parameters
    ----------
    component
        The cells.
    wheel
        The wheel as designed.
    parameters
        Of the model.
    """
    solution = part(component.two_way(), parameters)
    refused = None if solution.converged else NOT_CONVERGED
    if refused is None and _is_steep(component, wheel.on_reference, parameters):
        refused = NEXT_TO_JUMP
    if refused is None and solution.interaction > parameters.most_interaction:
        text = f"neither wheel nor rail explains {solution.interaction:.3f} of the conicities at this amplitude"
        refused = Reason(ReasonCode.RAILS_INTERACT, text)
    if refused is not None:
        solved, _ = solution.reference_wheel(float(wheel.on_reference[component.k]))
        return Answer(
            {key: RailAt.unknown(refused, float(one)) for key, one in zip(component.rails, solved, strict=True)},
            {key: WheelAt.unknown(refused) for key in component.wheels},
            interaction=solution.interaction,
        )
    publisher = _Publisher(component, solution, wheel, parameters)
    return Answer(publisher.rails(), publisher.wheels(), publisher.trends(), solution.interaction)


@dataclass(frozen=True, slots=True)
class _Publisher:
    """Turns a solution into estimates.

    Systematic errors are those that residuals do not show. What all cells share (creep, stiffness, a sensor's scale) is
    in proportion to the conicity: of a difference of rails it leaves as much as that is of the conicity. The scale of
    y - d that the alignment of a section leaves open belongs to the section, and looks like its rails.
    """

    component: Component
    solution: Parted
    wheel: ReferenceWheel
    parameters: RailsParameters

    def rails(self) -> dict[RailKey, RailAt]:
        """Return what is published of every rail."""
        counts, found = self._counts(), {}
        for place, key in enumerate(self.component.rails):
            wheelsets, windows = counts[key]
            if key.section in self.component.known_rails:
                found[key] = self._of_known(key, wheelsets, windows)
            else:
                found[key] = self._of_rail(place, key, wheelsets, windows)
        return found

    def wheels(self) -> dict[WheelKey, WheelAt]:
        """Return what is published of every wheel."""
        reference = self.component.reference
        windows: defaultdict[WheelKey, int] = defaultdict(int)
        for cell in self.component.cells:
            windows[cell.wheel] += cell.windows
        if reference is RailsReference.MEAN:
            nothing = self.component.level_open
            return {key: WheelAt(reference, Estimate.unknown(nothing, windows[key])) for key in windows}
        systematic, found = self._systematic_of_wheels(), {}
        for place, key in enumerate(self.component.wheels):
            theta, std = float(self.solution.wheel[place]), float(np.sqrt(self.solution.wheel_variance[place]))
            estimate = self._published(theta, std, float(systematic[place]), windows[key])
            found[key] = WheelAt(reference, estimate)
        return found

    def trends(self) -> dict[str, tuple[Estimate, int]]:
        """Return the trend of the reference wheel's conicity, 1/year, of sections with enough periods."""
        value, covariance = self.solution.reference_wheel(self._design)
        covariance = covariance + self.solution.interaction**2 * np.eye(len(value))
        at = self._years()
        places: defaultdict[str, list[int]] = defaultdict(list)
        for place, key in enumerate(self.component.rails):
            if key.section not in self.component.known_rails and self._no_conclusion(place, key) is None:
                places[key.section].append(place)
        found = {}
        for section, own in places.items():
            if len(own) >= self.parameters.least_periods:
                slope, std = _slope(at[own], value[own], covariance[np.ix_(own, own)])
                estimate = with_interval(slope, std, self._shared * abs(slope), self._groups, float(len(own)))
                found[section] = (estimate, len(own))
        return found

    def _of_rail(self, place: int, key: RailKey, wheelsets: int, windows: int) -> RailAt:
        reference, rho = self.component.reference, float(self.solution.rail[place])
        std = float(np.sqrt(self.solution.covariance[place, place]))
        part = self._published(rho, std, self._systematic(place, abs(rho)), windows)
        values, covariance = self.solution.reference_wheel(self._design)
        value = float(values[place])
        refused = self._no_conclusion(place, key)
        if refused is not None:
            nothing = Estimate.unknown(refused, float(windows))
            return RailAt(reference, part, nothing, nothing, wheelsets, value)
        std = float(np.sqrt(covariance[place, place] + self.solution.interaction**2))
        change = abs(value - self._design) + abs(float(self.solution.slope[place])) * self._mean
        systematic = self._systematic(place, change)
        whole = self._published(value, std, systematic, windows)
        on_file = float(self.wheel.of(key.section)[self.component.k])
        if not np.isfinite(on_file):
            unknown = Estimate.unknown(NO_REFERENCE_WHEEL, float(windows))
            return RailAt(reference, part, whole, unknown, wheelsets, value)
        excess = self._published(value - on_file, std, systematic, windows)
        return RailAt(reference, part, whole, excess, wheelsets, value)

    def _published(self, value: float, sampled: float, systematic: float, windows: int) -> Estimate:
        """Return an estimate with its interval; unknown where that says nothing of a wheel or a rail."""
        found = with_interval(value, sampled, systematic, self._groups, float(windows))
        if found.std is not None and found.std <= LARGEST_STD:
            return found
        text = f"the data leave the conicity open by {found.std:.2f}"
        return Estimate.unknown(Reason(ReasonCode.CONICITY_OPEN, text), float(windows))

    def _no_conclusion(self, place: int, key: RailKey) -> Reason | None:
        """Return why nothing follows from the wheels on some rails for the wheel as designed; None where it does."""
        if self.component.reference is RailsReference.MEAN:
            return self.component.level_open
        if not np.isfinite(self._design):
            return NO_REFERENCE_WHEEL
        if _is_steep(self.component, self.wheel.of(key.section), self.parameters):
            return NEXT_TO_JUMP
        cells = self.component.two_way()
        theta = self.solution.wheel[cells.wheel[cells.rail == place]]
        apart = max(float(theta.min()) - self._design, self._design - float(theta.max()))
        if apart <= self.parameters.farthest:
            return None
        text = f"the conicity of the wheel as designed is outside that of the wheels that run there by {apart:.3f}"
        return Reason(ReasonCode.REFERENCE_WHEEL_APART, text)

    def _of_known(self, key: RailKey, wheelsets: int, windows: int) -> RailAt:
        """Return what is said of rails that are as on file: nothing has been measured of them."""
        none, on_file = _exactly(0.0, windows), float(self.wheel.of(key.section)[self.component.k])
        if not np.isfinite(on_file):
            unknown = Estimate.unknown(NO_REFERENCE_WHEEL, float(windows))
            return RailAt(self.component.reference, none, unknown, unknown, wheelsets)
        return RailAt(self.component.reference, none, _exactly(on_file, windows), none, wheelsets)

    def _systematic(self, place: int, change: float) -> float:
        """Return the systematic std of a difference of rails that is as large as ``change``."""
        level = self._mean if self.component.reference is RailsReference.MEASURED_WHEELS else change
        of_section = float(np.hypot(self._scales()[place], self._scale_of_reference())) * self._mean
        return float(np.hypot(self._shared * level, of_section))

    def _systematic_of_wheels(self) -> FloatArray:
        """Return the systematic std (w,) of conicities on the reference rails."""
        if self.component.reference is RailsReference.KNOWN_RAILS:
            own = np.hypot(self._shared, self._scale_of_reference())
            return np.asarray(own * np.abs(self.solution.wheel))
        known = np.isfinite(self.component.two_way().known_value)
        apart = np.abs(self.solution.wheel - float(self.solution.wheel[known].mean()))
        return np.asarray(self._shared * apart)

    @property
    def _design(self) -> float:
        return float(self.wheel.on_reference[self.component.k])

    @property
    def _mean(self) -> float:
        return abs(self.solution.centre)

    @property
    def _groups(self) -> int:
        return 1 + max(1, int(self.solution.freedom))

    @property
    def _shared(self) -> float:
        """What is systematic in all cells, relative: the median of what is not the scale of the section."""
        k = self.component.k
        relative = [cell.systematic[k] / max(abs(float(cell.conicity[k])), 1e-3) for cell in self.component.cells]
        scale = np.array([cell.scale_std for cell in self.component.cells])
        return float(np.median(np.sqrt(np.maximum(np.array(relative) ** 2 - scale**2, 0.0))))

    def _scales(self) -> FloatArray:
        """Return the relative std (s,) of the scale of y - d on each section."""
        found = {cell.rail: cell.scale_std for cell in self.component.cells}
        return np.array([found[key] for key in self.component.rails])

    def _scale_of_reference(self) -> float:
        """Return that of the mean of what is the reference; what wheels hold has none."""
        scales, reference = self._scales(), self.component.reference
        if reference is RailsReference.MEASURED_WHEELS:
            return 0.0
        held = np.array([key.section in self.component.known_rails for key in self.component.rails])
        own = scales[held] if reference is RailsReference.KNOWN_RAILS else scales
        return float(np.sqrt((own**2).sum()) / len(own))

    def _years(self) -> FloatArray:
        """Return the mean time (s,) of what was seen of each rail, in years."""
        middle: defaultdict[RailKey, list[float]] = defaultdict(list)
        for cell in self.component.cells:
            middle[cell.rail].append(0.5 * (cell.from_ns + cell.to_ns))
        return np.array([np.mean(middle[key]) for key in self.component.rails]) / NS_PER_YEAR

    def _counts(self) -> dict[RailKey, tuple[int, int]]:
        """Return by rail how many wheelsets and windows there are."""
        serials: defaultdict[RailKey, set[str]] = defaultdict(set)
        windows: defaultdict[RailKey, int] = defaultdict(int)
        for cell in self.component.cells:
            serials[cell.rail].add(cell.wheel.wheelset)
            windows[cell.rail] += cell.windows
        return {key: (len(serials[key]), windows[key]) for key in serials}


def _is_steep(component: Component, curve: FloatArray, parameters: RailsParameters) -> bool:
    """Whether the conicity (k,) of the wheel as designed, on rails as on file, changes steeply about the amplitude."""
    return bool(next_to_jump(curve, component.cells[0].amplitude, parameters.steepest)[component.k])


def _exactly(value: float, windows: int) -> Estimate:
    return Estimate(value, 0.0, value, value, float(windows), Status.ESTIMATED)


def _slope(at: FloatArray, value: FloatArray, covariance: FloatArray) -> tuple[float, float]:
    """Return the slope of a line through correlated values (p,), and its standard deviation."""
    line = np.column_stack([np.ones(len(at)), at - at.mean()])
    weighted = np.linalg.solve(covariance, line)
    matrix = line.T @ weighted
    found = np.linalg.solve(matrix, weighted.T @ value)
    return float(found[1]), float(np.sqrt(np.linalg.inv(matrix)[1, 1]))
