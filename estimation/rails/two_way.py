"""The mixed model: conicity = wheel + rail + slope of the rail times the wheel, solved with its covariance.

For wheel ``w`` on rails ``s``, at one amplitude,

    y_ws = theta_w + rho_s + beta_s (theta_w - m) + e_ws,    beta_s ~ N(0, slope_std^2),    e_ws ~ N(0, v_ws + tau^2)

``theta`` is the conicity on the reference rails, where rho and beta are 0; ``m`` is a fixed number, the mean of
all ``y``. How much a worn rail adds depends on the wheel: contact geometry of worn heads gives slopes within some 0.3.
It is a regression with errors in both: the thetas are parameters, eliminated wheel by wheel, so that what is solved has
two numbers a section. ``tau``, what is left, follows from the residuals, with what is known of it beforehand.

A constant can be moved between all wheels and all rails. It is held by rails that are known (no rho, no beta), by
wheels that are known (observations of theta, whose residuals count as those of cells do), or else by the mean of the
sections; then the level is open.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.linalg.lapack import dpotrf, dpotri
from scipy.optimize import brentq
from scipy.sparse import csr_array

from estimation.rails.parameters import RailsParameters
from estimation.values.arrays import BoolArray, FloatArray, IntArray
from estimation.values.memory import MEMORY


@dataclass(frozen=True, slots=True)
class TwoWay:
    """Cells of connected wheels and rails at one amplitude."""

    wheel: IntArray  # (n,) number of the wheel, 0 to w - 1
    rail: IntArray  # (n,) number of the rails, 0 to s - 1
    value: FloatArray  # (n,) conicity
    variance: FloatArray  # (n,)
    known_rail: BoolArray  # (s,)
    known_value: FloatArray  # (w,) conicity of wheels on the reference rails; NaN where not known
    known_variance: FloatArray  # (w,)

    @property
    def anchored(self) -> bool:
        """Whether rails or wheels hold the level."""
        return bool(self.known_rail.any() or np.isfinite(self.known_value).any())


@dataclass(frozen=True, slots=True)
class Parted:
    """The solution; what is known has no variance."""

    wheel: FloatArray  # (w,) theta
    wheel_variance: FloatArray  # (w,)
    rail: FloatArray  # (s,) rho
    slope: FloatArray  # (s,) beta
    covariance: FloatArray  # (2 s, 2 s) of rho and beta
    interaction: float  # tau
    freedom: float  # degrees of freedom behind it
    centre: float  # m
    converged: bool
    rail_moved: FloatArray  # (s,) by how much rho changes where the conicity of all known wheels is higher by 1
    wheel_moved: FloatArray  # (w,) theta likewise
    known_weight: FloatArray  # (w,) weight of the conicity of each known wheel; 0 of the others
    own: FloatArray  # (w,) weight of each theta where rails are known
    shared: csr_array  # (w, 2 s) by how much a theta falls with rho and beta

    def reference_wheel(self, conicity: float) -> tuple[FloatArray, FloatArray]:
        """Return the conicity (s,) of a wheel on all rails, and its covariance (s, s), what is left not included."""
        above = conicity - self.centre
        s = len(self.rail)
        half = self.covariance[:s] + above * self.covariance[s:]
        return conicity + self.rail + self.slope * above, half[:, :s] + above * half[:, s:]


def part(cells: TwoWay, parameters: RailsParameters) -> Parted:
    """Return wheels and rails apart."""
    # where known wheels differ by more than their errors and the interaction explain, their errors count as larger
    solved: _Solved | None = None

    def surplus(decades: float) -> float:
        """Return by how much residuals are too large for a tau of 10^``decades``; it falls with that."""
        nonlocal solved
        tau = 10.0**decades
        solved = _solved(cells, parameters, tau, solved.point if solved is not None and solved.converged else None)
        if not solved.converged:
            return np.inf
        before = parameters.interaction_weight * ((parameters.interaction / tau) ** 2 - 1.0)
        return float(solved.squares() - solved.freedom() + before)

    if surplus(parameters.lowest_tau) > 0.0 > surplus(parameters.highest_tau):
        surplus(float(brentq(surplus, parameters.lowest_tau, parameters.highest_tau, xtol=parameters.tau_tolerance)))
    elif surplus(parameters.lowest_tau) > 0.0:
        surplus(parameters.highest_tau)
    assert solved is not None
    return _widened(cells, parameters, solved.parted())


def with_known(cells: TwoWay, parameters: RailsParameters, without: Parted) -> Parted:
    """Return the solution with known wheels that is next to the one without them, at the same interaction."""
    # it is one step from there: slopes of the rails do not follow a wheel that is known wrongly
    point = _Point(without.wheel, np.concatenate([without.rail, without.slope]), without.centre)
    problem = _Problem.of(cells, parameters, without.interaction)
    linear = problem.linearised(point)
    return _Solved(problem, problem.moved(point, linear, limited=False), linear, converged=without.converged).parted()


def _widened(cells: TwoWay, parameters: RailsParameters, solution: Parted) -> Parted:
    is_known = np.isfinite(cells.known_value)
    if not solution.converged or not is_known.any():
        return solution
    weight = solution.known_weight[is_known]
    squares = float(np.sum(weight * (cells.known_value - solution.wheel)[is_known] ** 2))
    freedom = float(np.sum(1.0 - weight * solution.wheel_variance[is_known]))
    factor = squares / freedom if freedom > parameters.least_freedom else 1.0
    if factor <= 1.0:
        return solution
    tau = solution.interaction
    wider = replace(cells, known_variance=(cells.known_variance + tau**2) * factor - tau**2)
    return replace(_solved(wider, parameters, tau, None).parted(), freedom=solution.freedom)


@dataclass(frozen=True, slots=True)
class _Point:
    theta: FloatArray  # (w,)
    phi: FloatArray  # (2 s,) rho and beta
    centre: float


@dataclass(frozen=True, slots=True)
class _Linear:
    residual: FloatArray  # (n,)
    own: FloatArray  # (w,) weight of each theta
    right_wheel: FloatArray  # (w,)
    crossed: csr_array  # (w, 2 s) of thetas with rho and beta
    shared: csr_array  # (w, 2 s) by how much a theta falls with rho and beta
    matrix: FloatArray  # (2 s, 2 s)
    right: FloatArray  # (2 s,)


@dataclass(frozen=True, slots=True)
class _Problem:
    cells: TwoWay
    parameters: RailsParameters
    tau: float
    weight: FloatArray  # (n,) of cells
    known: FloatArray  # (w,) of thetas that are known; 0 of the others
    before: FloatArray  # (2 s,) of what is known of rho and beta beforehand
    free: IntArray  # which rho and beta are not known
    places: IntArray  # (2 n,) of rho and beta of each cell
    begin: IntArray  # (w + 1,) of the places of each wheel

    @staticmethod
    def of(cells: TwoWay, parameters: RailsParameters, tau: float) -> _Problem:
        s, is_known = len(cells.known_rail), np.isfinite(cells.known_value)
        if (np.diff(cells.wheel) < 0).any():
            order = np.argsort(cells.wheel, kind="stable")
            names = ("wheel", "rail", "value", "variance")
            cells = replace(cells, **{name: getattr(cells, name)[order] for name in names})
        count = np.bincount(cells.wheel, minlength=len(is_known))
        return _Problem(
            cells,
            parameters,
            tau,
            1.0 / (cells.variance + tau**2),
            np.where(is_known, 1.0 / np.where(is_known, cells.known_variance + tau**2, 1.0), 0.0),
            np.concatenate([np.zeros(s), np.full(s, parameters.slope_std**-2)]),
            np.flatnonzero(np.tile(~cells.known_rail, 2)),
            np.column_stack([cells.rail, cells.rail + s]).ravel(),
            np.concatenate([[0], np.cumsum(2 * count)]),
        )

    def linearised(self, point: _Point) -> _Linear:
        """Return the sums of the regression about a point."""
        cells, weight, s, w = self.cells, self.weight, len(self.cells.known_rail), len(self.known)
        theta, rho, beta = point.theta, point.phi[:s], point.phi[s:]
        above = theta[cells.wheel] - point.centre
        a = 1.0 + beta[cells.rail]
        residual = cells.value - theta[cells.wheel] - rho[cells.rail] - beta[cells.rail] * above
        own = self.known + np.bincount(cells.wheel, weight * a * a, minlength=w)
        apart = np.where(self.known > 0.0, np.nan_to_num(cells.known_value) - theta, 0.0)
        right_wheel = self.known * apart + np.bincount(cells.wheel, weight * a * residual, minlength=w)
        values = (weight * a)[:, None] * np.column_stack([np.ones(len(above)), above])
        crossed = csr_array((values.ravel(), self.places, self.begin), shape=(w, 2 * s))
        by_wheel = values.ravel() * np.repeat(1.0 / own, np.diff(self.begin))
        shared = csr_array((by_wheel, self.places, self.begin), shape=(w, 2 * s))
        matrix: FloatArray = -np.asarray((crossed.T @ shared).toarray(), np.float64)
        first, both, second = (np.bincount(cells.rail, weight * above**power, minlength=s) for power in (0, 1, 2))
        at = np.arange(s)
        matrix[at, at] += first
        matrix[at, at + s] += both
        matrix[at + s, at] += both
        matrix[at + s, at + s] += second + self.before[s:]
        pulls = (np.bincount(cells.rail, weight * residual * above**power, minlength=s) for power in (0, 1))
        right = np.concatenate(list(pulls)) - crossed.T @ (right_wheel / own) - self.before * point.phi
        if not cells.anchored:
            held = self.parameters.mean_weight * weight.max()
            for half in (slice(0, s), slice(s, 2 * s)):
                matrix[half, half] += held
                right[half] -= held * point.phi[half].sum()
        return _Linear(residual, own, right_wheel, crossed, shared, matrix, right)

    def moved(self, point: _Point, linear: _Linear, *, limited: bool = True) -> _Point:
        """Return the solution of the linear model, slopes within their limits."""
        s = len(self.cells.known_rail)
        step = np.zeros(2 * s)
        if len(self.free):
            step[self.free] = _solution(linear.matrix[np.ix_(self.free, self.free)], linear.right[self.free])
            if limited:
                step[s:] = np.clip(point.phi[s:] + step[s:], *self.parameters.slope_range) - point.phi[s:]
        of_theta = linear.right_wheel / linear.own - linear.shared @ step
        return _Point(point.theta + of_theta, point.phi + step, point.centre)


@dataclass(slots=True)
class _Solved:
    problem: _Problem
    point: _Point
    linear: _Linear  # about it
    converged: bool
    covariance: FloatArray = field(init=False)  # (2 s, 2 s)

    def __post_init__(self) -> None:
        free = self.problem.free
        self.covariance = np.zeros((len(self.point.phi),) * 2)
        if len(free):
            self.covariance[np.ix_(free, free)] = _inverse(self.linear.matrix[np.ix_(free, free)])
        self.converged = self.converged and bool((np.diag(self.covariance) >= 0.0).all())

    def squares(self) -> float:
        """Return the weighted squares of the residuals, of cells and of known wheels."""
        problem = self.problem
        apart = np.where(problem.known > 0.0, np.nan_to_num(problem.cells.known_value) - self.point.theta, 0.0)
        return float(np.sum(problem.weight * self.linear.residual**2) + np.sum(problem.known * apart**2))

    def freedom(self) -> float:
        """Return how many residuals, of cells and of known wheels, are left over by what is fitted."""
        # a number that is fitted takes one, less what is known of it beforehand
        cells = self.problem.cells
        residuals = len(cells.value) + int(np.isfinite(cells.known_value).sum())
        fitted = len(cells.known_value) + 2 * int((~cells.known_rail).sum())
        conditions = 0.0 if cells.anchored else 2.0  # of the means of rho and of beta
        return residuals - (fitted - float(self.problem.before @ np.diag(self.covariance)) - conditions)

    def parted(self) -> Parted:
        s, known, linear = len(self.problem.cells.known_rail), self.problem.known, self.linear
        moved = self.covariance @ -(linear.crossed.T @ (known / linear.own))
        return Parted(
            wheel=self.point.theta,
            wheel_variance=1.0 / linear.own + _quadratic(linear.shared, self.covariance),
            rail=self.point.phi[:s],
            slope=self.point.phi[s:],
            covariance=self.covariance,
            interaction=self.problem.tau,
            freedom=self.problem.parameters.interaction_weight + self.freedom(),
            centre=self.point.centre,
            converged=self.converged,
            rail_moved=moved[:s],
            wheel_moved=known / linear.own - linear.shared @ moved,
            known_weight=known,
            own=linear.own,
            shared=linear.shared,
        )


def _solved(cells: TwoWay, parameters: RailsParameters, tau: float, start: _Point | None) -> _Solved:
    problem = _Problem.of(cells, parameters, tau)
    s, centre = len(cells.known_rail), float(np.mean(cells.value))
    point, converged = start or _Point(np.full(len(cells.known_value), centre), np.zeros(2 * s), centre), False
    for _ in range(parameters.fit_rounds):
        before, point = point, problem.moved(point, problem.linearised(point))
        change = np.concatenate([point.theta - before.theta, (point.phi - before.phi)[:s]])
        if np.abs(change).max() < parameters.conicity_tolerance:
            converged = True
            break
    return _Solved(problem, point, problem.linearised(point), converged)


def _solution(matrix: FloatArray, right: FloatArray) -> FloatArray:
    try:
        return np.asarray(cho_solve(cho_factor(matrix, check_finite=False), right, check_finite=False))
    except np.linalg.LinAlgError:
        return np.full_like(right, np.nan)


def _inverse(matrix: FloatArray) -> FloatArray:
    factor, bad = dpotrf(matrix, lower=1)
    inverse, worse = dpotri(factor, lower=1)
    if bad or worse:
        return np.full_like(matrix, np.nan)
    low = np.tril(inverse)
    return np.asarray(low + np.tril(low, -1).T)


def _quadratic(rows: csr_array, covariance: FloatArray) -> FloatArray:
    """Return the variance (n,) of linear combinations, the rows (n, k), of what has a covariance (k, k)."""
    blocks = (rows[first : first + MEMORY.covariance_rows] for first in range(0, rows.shape[0], MEMORY.covariance_rows))
    return np.concatenate([np.empty(0), *(block.multiply(block @ covariance).sum(axis=1) for block in blocks)])
