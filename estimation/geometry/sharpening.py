"""A rolling radius difference without the blur of its displacement.

The error of y - d, and a gauge that moves contact jumps, blur a curve R(x) over some tenths of a millimetre; the
quadratics of the bins blur it further. What is behind is found by least squares with bounds (``non_negative``): R is
the integral of slopes in cells of an eighth of a bin. Blurred by a normal error and reduced to the quadratics of the
bins, it has to give the nodes that were observed. A slope is not negative, or no more than twice what was observed;
this is what brings a jump back into one place.

How far the blur reaches is known roughly. The longest that the nodes allow is taken: one that is too long leaves a
misfit, because no curve within the bounds becomes as sharp as what was observed.

How far the springs of a bogie hold a wheelset off the line on which both its wheels roll alike.

Band-limited signals show R = rL - rR about the mean running position. A free wheelset runs on average where R is zero,
about which EN 15302 takes the conicity. In a bogie a difference of the diameters, R(x) = lambda x + rho, is shared out
between both wheelsets and the springs; what of it is left in R on average follows from the balance of forces and
moments of both wheelsets (1 in front) and of the frame at constant speed on straight track:

    2 f22 psi_i + ky delta_i = 0,                    delta_i = y_f +- a psi_f - y_i
    c (lambda y_i + rho_i) + k_psi (psi_i - psi_f) = 0,                          c = l f11 / r0
    ky (delta_1 + delta_2) + ks y_f = 0,     k_psi sum(psi_i - psi_f) = a ky (delta_1 - delta_2) + k2 psi_f

What an estimated curve says of the roll of its contact, and so of the displacement that EN 15302 means.

The motion looks R up by the displacement at the centre of curvature of the rail head, 80 mm below its top. Two things
are open there, of which the curve itself knows.

Where the track may roll, phi_c is hidden. Wheels that roll much are steep: R without its rises is twice the contact
angle times the displacement, as far as wheels do not follow the head, and phi_c is the contact angle too.

Where R rises steeply, the wheel on the smaller radius passes the crown of its rail, or jumps over it. A wheel that
touches at two places turns about the point where the normals of both meet, which is deeper than the centre of the arc
beside the crown: the rise is further out than the rest of the curve says. A jump to the gauge corner comes where R has
been flat and the wheelset has hardly rolled: it stays.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from functools import lru_cache

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.special import ndtr, ndtri

from estimation.contact.conicity import equivalent_conicity, zero_crossing
from estimation.motion.parameters import MOTION
from estimation.values.arrays import BoolArray, FloatArray, IntArray
from estimation.values.memory import MEMORY
from estimation.vehicle.parameters import VEHICLE
from estimation.vehicle.vehicle_class import VehicleClass


@dataclass(frozen=True, slots=True)
class SharpeningParameters:
    """How what filters have blurred is undone."""

    held_gradient_share: float = 1e-12  # of the largest gradient: below, an unknown that is held at 0 stays there
    patient_exchanges: int = 3  # exchanges of all without fewer on the wrong side, before it is one at a time
    bin_cells: int = 8  # in a bin
    least_node_std: float = 5e-6  # m of a node: blurs are not quite normal
    least_roughness: float = 0.25  # std that slopes differ by from cell to cell; a contact jump has 2 to 10
    blur_roughness: float = 2.5e3  # 1/m, the same per blur: the longer it is, the less of the slopes is known
    most_misfit_rms: float = 1.0  # rms, in std of the nodes
    blur_shares: tuple[float, ...] = (1.0, 0.9, 0.8, 0.7, 0.6, 0.5, 0.4, 0.3, 0.2, 0.1, 0.0)  # of the longest
    bin_samples: int = 8  # in a bin, for its quadratic
    reach_blurs: float = 3.0  # std of the blur that the cells go beyond the bins
    search_steps: int = 200  # of the search for slopes; most end after ten
    steep_factor: float = 2.0  # times the median slope: what is steeper is part of a jump
    diameter_std: float = 0.3e-3  # m, left minus right wheel: EN 15313 allows 0.3 to 0.5 mm when turned, later 1 mm
    held_slopes: tuple[float, ...] = (0.02, 0.05, 0.1, 0.2, 0.4, 0.8)  # lambda, twice the conicity
    roll_per_displacement: float = 0.03  # rad/m, of phi_c, of any wheel
    roll_per_radius: float = 0.3  # rad/m, of phi_c per R without its rises
    deviates: int = 8  # values that stand for a normal distribution
    crown_depth: float = 0.16  # m, below the rail head: about where a wheel turns that passes its crown


SHARPENING = SharpeningParameters()
SLOPES = SHARPENING.held_slopes


@dataclass(frozen=True, slots=True)
class Bounded:
    """A solution; linear in the right side as long as the same unknowns are free."""

    value: FloatArray  # (n,)
    free: IntArray  # which are not held at 0
    scale: FloatArray  # (n,) by which unknowns are multiplied before they are solved
    factor: tuple[FloatArray, bool]  # of the free ones

    def linear(self, right: FloatArray) -> FloatArray:
        """Return what the unknowns (n, m) are for right sides (n, m), with the same ones free."""
        found = np.zeros(right.shape)
        scale = self.scale[self.free, None]
        found[self.free] = cho_solve(self.factor, scale * right[self.free], check_finite=False) * scale
        return found


def non_negative(gram: FloatArray, right: FloatArray, most: int) -> Bounded | None:
    """Return the least squares of which the first unknown has any sign, and the others are not negative.

    None where ``most`` exchanges do not suffice, or the matrix (n, n) does not determine the unknowns.
    """
    diagonal = np.diag(gram)
    if not (diagonal > 0.0).all():
        return None
    scale = 1.0 / np.sqrt(diagonal)
    matrix, wanted = gram * scale * scale[:, None], right * scale
    free = np.ones(len(right), dtype=np.bool_)
    fewest, patience = len(right) + 1, SHARPENING.patient_exchanges
    for _ in range(most):
        places = np.flatnonzero(free)
        try:
            factor = cho_factor(matrix[np.ix_(places, places)], lower=True, check_finite=False)
        except np.linalg.LinAlgError:
            return None
        value = np.zeros(len(right))
        value[places] = cho_solve(factor, wanted[places], check_finite=False)
        wrong = _wrong(value, matrix @ value - wanted, free)
        if not wrong.any():
            return Bounded(value * scale, places, scale, factor)
        patience = SHARPENING.patient_exchanges if wrong.sum() < fewest else patience - 1
        fewest = min(fewest, int(wrong.sum()))
        last = np.arange(len(wrong)) == np.flatnonzero(wrong)[-1]
        free = free ^ (wrong if patience >= 0 else last)
    return None


def _wrong(value: FloatArray, gradient: FloatArray, free: BoolArray) -> BoolArray:
    """Return which unknowns are negative, or would lower the sum if they were free; never the first one."""
    wrong = np.where(free, value < 0.0, gradient < -SHARPENING.held_gradient_share * np.abs(gradient).max())
    wrong[0] = False
    return wrong


@dataclass(frozen=True, slots=True)
class Sharpening:
    """How nodes of a curve become a sharp one; linear in the nodes: slopes that were at their bound stay there."""

    displacement: FloatArray  # (n,) m
    blur: float  # m, std that is taken away
    left: float  # m, std that is not taken away because nothing fits
    inverse: FloatArray  # (n, m) value at a displacement per value at a node
    constant: FloatArray  # (n,) m

    def curve(self, nodes: FloatArray) -> FloatArray:
        """Return the sharp curve (n,), m, of values at the nodes (m,)."""
        return np.asarray(self.inverse @ nodes + self.constant)


def edges_and_centres(low: FloatArray, high: FloatArray) -> FloatArray:
    """Return the nodes of adjoining bins, ascending: (2 b + 1,)."""
    return np.append(np.column_stack([low, 0.5 * (low + high)]).ravel(), high[-1])


def nodes_of(shape: FloatArray) -> FloatArray:
    """Return quadratics of bins (b, 3, ...) over u at the nodes (2 b + 1, ...); at an edge the mean of both bins."""
    value, slope, curvature = shape[:, 0], shape[:, 1], shape[:, 2]
    at_low, at_high = value - slope / 2 + curvature / 4, value + slope / 2 + curvature / 4
    at_edge = np.concatenate([at_low[:1], 0.5 * (at_low[1:] + at_high[:-1])])
    inner = np.stack([at_edge, value], axis=1).reshape(2 * len(value), *value.shape[1:])
    return np.concatenate([inner, at_high[-1:]])


def sharpen(
    low: FloatArray,
    high: FloatArray,
    nodes: FloatArray,
    std: FloatArray,
    longest: float,
    steps: int = SHARPENING.search_steps,
) -> Sharpening:
    """Return how to take away the longest blur up to ``longest`` that the nodes allow.

    Args:
        low, high: (b,) m, edges of adjoining bins of one width.
        nodes: (2 b + 1,) m, the curve at :func:`edges_and_centres`.
    """
    weight = 1.0 / np.hypot(std, SHARPENING.least_node_std)
    least = min(0.0, 2.0 * float(np.min(np.diff(nodes[1::2]) / np.diff(low)))) if len(low) > 1 else 0.0
    for share in SHARPENING.blur_shares:
        found = _sharpen(low, high, nodes, weight, share * longest, least, steps)
        if found is not None:
            return found
    # nothing is taken away: blurred, and jumps anywhere in their bins
    x, in_bin = edges_and_centres(low, high), float(high[0] - low[0]) / np.sqrt(12.0)
    return Sharpening(x, 0.0, float(np.hypot(longest, in_bin)), np.eye(len(x)), np.zeros(len(x)))


def _sharpen(
    low: FloatArray, high: FloatArray, nodes: FloatArray, weight: FloatArray, blur: float, least: float, steps: int
) -> Sharpening | None:
    """Return how to take away a blur (m); None where no curve with slopes of at least ``least`` becomes these nodes."""
    width = float(high[0] - low[0])
    step, beyond = width / SHARPENING.bin_cells, _beyond(width, blur)
    response = _response(len(low), width, blur)
    cells = response.shape[1]
    base = least * response.sum(axis=1)
    rows = weight[:, None] * np.column_stack([np.ones(len(nodes)), response])
    wanted = weight * (nodes - base)
    gram = rows.T @ rows
    gram[1:, 1:] += max(SHARPENING.least_roughness, SHARPENING.blur_roughness * blur) ** 2 * _changes(cells)
    found = non_negative(gram, rows.T @ wanted, steps)
    if found is None or np.sqrt(np.mean((rows @ found.value - wanted) ** 2)) > SHARPENING.most_misfit_rms:
        return None
    solved = found.linear(rows.T * weight)
    inside = slice(beyond, cells + 1 - beyond)
    integral = np.concatenate([np.zeros((1, len(nodes))), np.cumsum(step * solved[1:], axis=0)]) + solved[0]
    slope = least * step * np.arange(cells + 1)
    return Sharpening(
        displacement=low[0] + step * np.arange(cells + 1 - 2 * beyond),
        blur=blur,
        left=0.0,
        inverse=integral[inside],
        constant=(slope - integral @ base)[inside],
    )


@lru_cache(maxsize=MEMORY.sharpening_operators)
def _changes(cells: int) -> FloatArray:
    """Return the normal matrix (cells, cells) of changes of the slope from cell to cell."""
    matrix = 2.0 * np.eye(cells) - np.eye(cells, k=1) - np.eye(cells, k=-1)
    matrix[[0, -1], [0, -1]] = 1.0
    matrix.flags.writeable = False
    return matrix


def _beyond(width: float, blur: float) -> int:
    return max(SHARPENING.bin_cells, int(np.ceil(SHARPENING.reach_blurs * blur * SHARPENING.bin_cells / width)))


@lru_cache(maxsize=MEMORY.sharpening_operators)
def _response(bins: int, width: float, blur: float) -> FloatArray:
    beyond = _beyond(width, blur)
    edges = width / SHARPENING.bin_cells * (np.arange(SHARPENING.bin_cells * bins + 2 * beyond + 1) - beyond)
    u = (np.arange(SHARPENING.bin_samples) + 0.5) / SHARPENING.bin_samples - 0.5
    x = width * (np.arange(bins)[:, None] + 0.5 + u)
    ramp = _blurred_ramp(x.ravel()[:, None] - edges, blur)
    curves = (ramp[:, :-1] - ramp[:, 1:]).reshape(bins, SHARPENING.bin_samples, -1)
    quadratic = np.linalg.pinv(np.vander(u, 3, increasing=True))
    response = nodes_of(np.einsum("kq,bqn->bkn", quadratic, curves))
    response.flags.writeable = False
    return response


def _blurred_ramp(x: FloatArray, blur: float) -> FloatArray:
    """Return max(x, 0) averaged over a normal error of x with std ``blur``."""
    if blur <= 0.0:
        return np.maximum(x, 0.0)
    z = x / blur
    return np.asarray(x * ndtr(z) + blur / np.sqrt(2.0 * np.pi) * np.exp(-0.5 * z**2))


def jumps_displaced(x: FloatArray, curve: FloatArray, middle: float, by: float) -> FloatArray:
    """Return a curve (n,) whose contact jumps are further from ``middle`` by ``by`` (m; negative: nearer)."""
    _, rises = split_at_rises(x, curve, middle)
    return np.asarray(curve - rises + displaced(x, rises, middle, by))


def split_at_rises(x: FloatArray, curve: FloatArray, middle: float) -> tuple[FloatArray, FloatArray]:
    """Return a curve (n,) without what is steep or falls, and what is steep of it; both are zero at ``middle``."""
    slope, steps = np.diff(curve) / np.diff(x), np.diff(x)
    limit = SHARPENING.steep_factor * max(float(np.median(slope)), 0.0)
    flat = np.append(0.0, np.cumsum(np.clip(slope, 0.0, limit) * steps))
    rises = np.append(0.0, np.cumsum(np.maximum(slope - limit, 0.0) * steps))
    return flat - np.interp(middle, x, flat), rises - np.interp(middle, x, rises)


def displaced(x: FloatArray, values: FloatArray, middle: float, by: float | FloatArray) -> FloatArray:
    """Return values (n,) that are further from ``middle`` by ``by`` (m, or (n,) m; negative: nearer)."""
    away = x - middle
    return np.interp(middle + np.sign(away) * np.maximum(np.abs(away) - by, 0.0), x, values)


FREE = (0.0,) * len(SLOPES)


def held_shares(vehicle_class: VehicleClass) -> tuple[float, ...]:
    """Return which share of rho is left in R on average, at each of ``SLOPES``; zero without a bogie."""
    # of the rms over front and rear wheelset, each with differences of diameters of its own and of its neighbour
    if vehicle_class.bogie is None:
        return FREE
    return tuple(float(np.sqrt((left_in_difference(vehicle_class, slope) ** 2).sum() / 2.0)) for slope in SLOPES)


def left_in_difference(vehicle_class: VehicleClass, slope: float) -> FloatArray:
    """Return the mean R (2, 2) of the front and the rear wheelset by rho of each."""
    p, bogie = vehicle_class.parameters, vehicle_class.bogie
    if bogie is None:
        return np.zeros((2, 2))
    c = p.half_contact_distance * p.longitudinal_creep_coefficient / p.nominal_radius
    f, ky, k, a = 2.0 * p.lateral_creep_coefficient, p.lateral_stiffness, p.yaw_stiffness, bogie.wheelbase / 2.0
    ks, k2 = bogie.secondary_lateral_stiffness, bogie.secondary_yaw_stiffness
    balance = np.array(  # of y_1, y_2, psi_1, psi_2, y_f, psi_f
        [
            [-ky, 0.0, f, 0.0, ky, ky * a],
            [0.0, -ky, 0.0, f, ky, -ky * a],
            [c * slope, 0.0, k, 0.0, 0.0, -k],
            [0.0, c * slope, 0.0, k, 0.0, -k],
            [ky, ky, 0.0, 0.0, -2.0 * ky - ks, 0.0],
            [a * ky, -a * ky, k, k, 0.0, -2.0 * (k + a * a * ky) - k2],
        ]
    )
    by_rho = np.zeros((6, 2))
    by_rho[2, 0] = by_rho[3, 1] = -c
    return np.asarray(slope * np.linalg.lstsq(balance, by_rho, rcond=None)[0][:2] + np.eye(2))


def held_difference_std(shares: tuple[float, ...], conicity: float) -> float:
    """Return the std of the mean of R, m, of a wheelset whose difference of diameters is not known."""
    return 0.5 * SHARPENING.diameter_std * float(np.interp(2.0 * conicity, SLOPES, shares))


def moved_off(x: FloatArray, curve: FloatArray, amplitude: FloatArray, std: float) -> FloatArray:
    """Return the change of the conicity (a,) per standard deviation of the mean of R."""
    # about the running position the curve is nearly as it is about the rolling line, so that small differences change
    # little and large ones much
    here = equivalent_conicity(x, curve, amplitude)
    return rms_change(lambda share: equivalent_conicity(x, curve + share * std, amplitude), here)


# standard normal deviates of equal weight, with a mean square of one
_DEVIATES = ndtri((np.arange(SHARPENING.deviates) + 0.5) / SHARPENING.deviates)
_DEVIATES /= np.sqrt(np.mean(_DEVIATES**2))


def rms_change(changed: Callable[[float], FloatArray], here: FloatArray) -> FloatArray:
    """Return the rms change over a normal distribution: a jump may be passed far out only."""
    changes = np.array([changed(float(deviate)) - here for deviate in _DEVIATES])
    # where a change leaves the range covered, the others count
    inside = ~np.isnan(changes)
    square = np.where(inside, changes, 0.0) ** 2
    return np.asarray(np.sqrt(square.sum(axis=0) / np.maximum(inside.sum(axis=0), 1)))


class ContactRoll(StrEnum):
    """Whether the roll of the contact is part of the displacement that a curve is over."""

    SEEN = "seen"  # on level track: as measured
    HIDDEN = "hidden"  # behind the roll of the track: a share that is alike for all wheels


def standard_curve(x: FloatArray, curve: FloatArray, roll: ContactRoll) -> tuple[FloatArray, FloatArray]:
    """Return displacement and rolling radius difference (n,), m, as EN 15302 means them.

    Args:
        x, curve: (n,) m, strictly increasing displacement as ``standard_displacement`` gives it, and R. Where R is
            nowhere zero it is left as it is.
    """
    middle = zero_crossing(x, curve)
    if not np.isfinite(middle):
        return x, curve
    away = x - middle
    flat, rises = split_at_rises(x, curve, middle)
    phi = SHARPENING.roll_per_displacement * away + SHARPENING.roll_per_radius * flat
    lever = SHARPENING.crown_depth - VEHICLE.rail_head_radius
    moved = curve - rises + displaced(x, rises, middle, lever * np.abs(phi))
    if roll is ContactRoll.SEEN:
        return x, moved
    taken = MOTION.hidden_roll_share / (1.0 + MOTION.hidden_roll_share) * away
    return x + VEHICLE.rail_head_radius * phi - taken, moved
