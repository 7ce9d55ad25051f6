"""Estimate of the lateral damper of a running gear.

``window_damper`` reduces one window to products of its filters' innovations. Sensor noise in the filters' input would
bias the parameters; what noise as on file adds to the products is subtracted (bias-compensated least squares).

``gear_damper`` turns the sums of many windows into a posterior over the share of damping left. Given that share, the
innovations are linear in the errors of the other parameters, whose standard deviations the class states. Each particle
solves for these errors, and its weight accounts for them (Rao-Blackwellised). The jackknife over groups of windows adds
what differs from window to window.
"""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtri, ndtr

from estimation.adhesion.creep_forces import GearSegment, GearSegments
from estimation.dampers.damper_filters import DamperFilters, add_products, damper_filters, of_signals
from estimation.dampers.parameters import DAMPING
from estimation.dampers.suspension_equations import (
    between_samples,
    low_pass,
    mass_std,
    nominal_damping,
    stride_of,
    thinned,
    uncertain_parameters,
)
from estimation.motion.integration import bridged
from estimation.values.arrays import BoolArray, FloatArray
from estimation.values.opinions import DamperSums, GearDamper, WindowDamper
from estimation.values.quantities import Estimate, Status, jackknife_std, with_interval
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.sums import SHARES
from estimation.values.units import NORMAL_95
from estimation.values.windows import Window
from estimation.vehicle.vehicle_class import ClassOnFile, VehicleClass


def looked_at(first: Window) -> bool:
    """Whether the damper is estimated from this window; true for one in N, whichever other windows exist."""
    # The start is hashed, so that a recorder that runs at regular times is not always left out. Both running gears of a
    # vehicle are estimated from the same windows.
    return zlib.crc32(f"{first.vehicle} {first.start_ns // first.length_ns}".encode()) % DAMPING.window_stride == 0


def window_damper(
    first: Window, content_digest: str, gear: GearSegments | Reason, on_file: ClassOnFile
) -> WindowDamper:
    """Return the sums of one window for the damper of a running gear, or the reason why it has none."""
    vehicle_class = on_file.vehicle_class
    sums_or_reason, over_limit = (gear, None) if isinstance(gear, Reason) else _window_sums(gear, vehicle_class)
    return WindowDamper(
        vehicle=first.vehicle,
        first_axle=first.axle,
        wheelset=first.wheelset,
        start_ns=first.start_ns,
        odometer_km=1e-3 * first.odometer_m,
        content_digest=content_digest,
        class_digest=on_file.digest,
        mass_std=mass_std(vehicle_class),
        innovation=over_limit,
        sums=None if isinstance(sums_or_reason, Reason) else sums_or_reason,
        reason=sums_or_reason if isinstance(sums_or_reason, Reason) else None,
    )


def _window_sums(gear: GearSegments, vehicle_class: VehicleClass) -> tuple[DamperSums | Reason, float | None]:
    """Return the sums of a window, or why there are none; and mean square innovation over its limit."""
    refused = not_judged(vehicle_class)
    if refused is not None:
        return refused, None
    filters = damper_filters(vehicle_class, gear.sample_interval_s)
    particles, signals, _ = filters.measured.shape
    products = np.zeros((particles - 1, signals + 1, signals + 1))
    count, square = 0, 0.0
    for segment in gear.segments:
        accelerations = _accelerations_and_count(segment, gear, filters.apart)
        if accelerations is None:
            continue
        _, above, counted = accelerations
        add_products(filters, *accelerations, products)
        count += int(counted.sum())
        square += float((above[0, counted] ** 2).sum())
    if count < DAMPING.fewest_samples:
        return Reason(ReasonCode.TOO_FEW_USABLE, f"{count} samples of deflections are known"), None
    return _judged(products, count, square, filters)


def not_judged(vehicle_class: VehicleClass) -> Reason | None:
    """Return why the damper of a class cannot be judged; None where it can."""
    if not nominal_damping(vehicle_class) > 0.0:
        return Reason(ReasonCode.DAMPER_NOT_ON_FILE, f"class {vehicle_class.code!r} has no lateral damper on file")
    for name, std in uncertain_parameters(vehicle_class).items():
        if std > DAMPING.largest_std:
            text = f"{name} of class {vehicle_class.code!r} has a std of {std:.0%}"
            return Reason(ReasonCode.SUSPENSION_UNCERTAIN, f"{text}; at most {DAMPING.largest_std:.0%} is usable")
    return None


def _accelerations_and_count(
    segment: GearSegment, gear: GearSegments, axle_spread: tuple[float, float]
) -> tuple[FloatArray, FloatArray, BoolArray] | None:
    """Return the accelerations (k, s), m/s2, below and above, as ``SOURCES`` names them, and which samples count (s,).

    None where the segment is too short for the filters.
    """
    axles, known, dt = gear.axles, segment.axles[0].known, gear.sample_interval_s
    stride, half = stride_of(dt), len(low_pass(dt)) // 2
    transient = round(DAMPING.unknown_begin_s / (stride * dt))
    if len(known) - 2 * half < 2 * transient * stride:
        return None
    signals = [segment.accelerations[: 2 * axles : 2], segment.accelerations[2 * axles :]]
    thinned_rows = [[thinned(bridged(signal, known), dt) for signal in rows] for rows in signals]
    means_and_differences = ((np.mean(rows, axis=0), 0.5 * (rows[0] - rows[-1])) for rows in thinned_rows)
    (below, below_difference), (above, above_difference) = means_and_differences
    raised, raised_difference = between_samples(below), between_samples(below_difference)
    delay = DAMPING.clock_std_s / (stride * dt)
    counted = known[half : len(known) - half][::stride].copy()
    counted[:transient] = counted[-1:] = False
    axle, axle_above = raised + axle_spread[0] * raised_difference, above + axle_spread[1] * above_difference
    below_rows = np.stack([raised, axle, raised, raised + delay * np.gradient(raised_difference)])
    return below_rows, np.stack([above, above, axle_above, above + delay * np.gradient(above_difference)]), counted


def _judged(
    products: FloatArray, count: int, square: float, filters: DamperFilters
) -> tuple[DamperSums | Reason, float]:
    all_products = of_signals(filters, products)
    least = min(_least_innovation(particle, count) for particle in all_products)
    over_limit = float(least) / (float(filters.noise[:, 0, 0].max()) + DAMPING.most_unexplained_share * square / count)
    if not (np.isfinite(over_limit) and over_limit <= 1.0):
        text = f"the innovations of the suspension's filters are {np.sqrt(over_limit):.1f} times the largest"
        return Reason(ReasonCode.DIVERGED, f"{text} that is plausible; check class and sensors"), over_limit
    independent = count * min(2.0 * DAMPING.pass_hz * filters.step_s, 1.0)
    scale = independent / (count * least + DAMPING.model_error**2 * square)
    excitation = _excitation(all_products * scale, count * scale * filters.noise)
    if not excitation > DAMPING.least_excitation:
        text = f"the motion shows the damper {max(excitation, 0.0):.1f} times as much as noise does"
        text += f", {DAMPING.least_excitation:g} times are needed"
        return Reason(ReasonCode.DAMPER_NOT_EXCITED, text), over_limit
    return DamperSums((all_products - count * filters.noise) * scale, independent, filters.curved), over_limit


def _excitation(products: FloatArray, noise: FloatArray) -> float:
    """Return by how much motion exceeds noise, relative to it, in the part that only the damper explains."""
    # Minimum over particles of: innovation change from one particle to the next, less what the other parameters explain
    others = products[:, 1:-1, 1:-1] + np.eye(products.shape[-1] - 2)
    explained = np.linalg.solve(others, products[:, 1:-1, -1:])[..., 0]
    direction = np.concatenate([-explained, np.ones((len(products), 1))], axis=1)
    inner = slice(1, None)
    moved, noisy = (np.einsum("pa,pab,pb->p", direction, m[:, inner, inner], direction) for m in (products, noise))
    return float((moved / noisy).min() - 1.0)


def _least_innovation(products: FloatArray, count: int) -> float:
    parameter_count = len(products) - 1
    ridge = np.diag(np.full(parameter_count, 0.25 * products[0, 0] / count))
    best = np.linalg.solve(products[1:, 1:] + ridge, -products[1:, 0])
    signal = np.append(1.0, np.clip(best, -2.0, 2.0))
    return float(signal @ products @ signal) / count


@dataclass(frozen=True, slots=True)
class DamperParameters:
    """Which windows count, and which estimates are published."""

    span_km: float = 5_000.0  # of the odometer, back from the newest window
    weak_share: float = 0.5  # a damper with less of its damping left is weak
    likely: float = 0.9  # least probability of a weak damper that makes a finding
    widest_std: float = 0.2  # largest std of a share that is published
    most_diverged: float = 0.2  # largest share of the windows that may diverge
    parameter_error_quantile: float = 0.99  # of chi-square; parameter errors beyond it are of no vehicle of the class
    shares_between: int = 16  # points of the posterior from one particle to the next
    window_groups: int = 12  # groups of the jackknife
    fewest_windows: int = 4
    largest_share: float = 1.9  # the particles end at 2
    apart_stds: float = 3.0  # two halves of the windows that differ by more standard deviations do not belong together
    changed_share: float = 0.1  # least difference of the share between such halves
    model_share_std: float = 0.05  # relative, by cross level, clocks and scales of nodes; docs/results/dampers.md
    least_share_std: float = 0.01  # absolute, for the same
    newton_rounds: int = 5  # Gauss-Newton iterations
    farthest_stds: float = 6.0  # largest error in standard deviations
    least_curvature: float = 0.2  # least eigenvalue of the parameters' precision; below it noise dominates


def gear_damper(windows: Sequence[WindowDamper], parameters: DamperParameters) -> GearDamper:
    """Return the finding on the damper of a running gear from its newest windows, in any order."""
    ordered = sorted(windows, key=lambda window: window.start_ns)
    newest = ordered[-1]
    recent = [
        window
        for window in ordered
        if window.class_digest == newest.class_digest and newest.odometer_km - window.odometer_km <= parameters.span_km
    ]
    informative = _newest_alike([window for window in recent if window.sums is not None], parameters)
    counted = [window for window in recent if not informative or window.start_ns >= informative[0].start_ns]
    diverged = sum(window.reason is not None and window.reason.code is ReasonCode.DIVERGED for window in counted)
    share = _share(informative, diverged, newest, parameters)
    std = None if share.low is None or share.high is None else 0.5 * (share.high - share.low) / NORMAL_95
    weak_probability = None
    if share.value is not None and std is not None:
        weak_probability = float(ndtr((parameters.weak_share - share.value) / std))
        share = replace(share, low=max(share.value - NORMAL_95 * std, 0.0))
    first, last = (informative or counted)[0], (informative or counted)[-1]
    return GearDamper(
        vehicle=newest.vehicle,
        first_axle=newest.first_axle,
        share=share,
        weak_probability=weak_probability,
        weak=None if weak_probability is None else weak_probability >= parameters.likely,
        windows=len(informative),
        diverged=diverged,
        refused=len(counted) - len(informative) - diverged,
        from_ns=first.start_ns,
        to_ns=last.start_ns,
        from_km=first.odometer_km,
        to_km=last.odometer_km,
    )


def _share(
    informative: Sequence[WindowDamper], diverged: int, newest: WindowDamper, parameters: DamperParameters
) -> Estimate:
    count, mismatch = float(len(informative)), Status.MODEL_MISMATCH
    if diverged > parameters.most_diverged * (len(informative) + diverged):
        text = f"the filters of the suspension have diverged in {diverged} of {len(informative) + diverged} windows"
        return Estimate.unknown(Reason(ReasonCode.DIVERGED, text), count, mismatch)
    if len(informative) < parameters.fewest_windows:
        text = f"{len(informative)} windows show the suspension, {parameters.fewest_windows} are needed"
        too_few = Reason(ReasonCode.TOO_FEW_WINDOWS, text)
        return Estimate.unknown(too_few if informative or newest.reason is None else newest.reason, count)
    overall, sampled = _replicated(informative, parameters)
    if overall is None or not np.isfinite(sampled):
        return Estimate.unknown(_not_excited("sensor noise alone explains the accelerations"), count)
    largest_errors = float(chdtri(overall.parameters, 1.0 - parameters.parameter_error_quantile))
    if overall.share > parameters.largest_share or overall.errors * overall.parameters > largest_errors:
        text = (
            f"the best fit has {overall.share:.2f} of the damping and needs other parameters"
            f" {np.sqrt(overall.errors):.1f} standard deviations off: not this class; check class and sensors"
        )
        return Estimate.unknown(Reason(ReasonCode.DIVERGED, text), count, mismatch)
    relative_std_of_share = np.hypot(newest.mass_std, parameters.model_share_std) * overall.share
    systematic = float(np.linalg.norm([overall.std, relative_std_of_share, parameters.least_share_std]))
    std = float(np.hypot(sampled, systematic))
    if std > parameters.widest_std:
        return Estimate.unknown(_not_excited(f"the standard deviation of its share would be {std:.2f}"), count)
    return with_interval(overall.share, sampled, systematic, min(len(informative), parameters.window_groups), count)


def _not_excited(why: str) -> Reason:
    return Reason(ReasonCode.DAMPER_NOT_EXCITED, f"what is above the wheelsets does not show the damper: {why}")


def _newest_alike(informative: Sequence[WindowDamper], parameters: DamperParameters) -> Sequence[WindowDamper]:
    while len(informative) >= 4 * parameters.fewest_windows:
        halves = informative[: len(informative) // 2], informative[len(informative) // 2 :]
        (old, old_std), (new, new_std) = (_replicated(half, parameters) for half in halves)
        if old is None or new is None:
            return informative
        difference = abs(new.share - old.share)
        if not difference > max(parameters.apart_stds * float(np.hypot(old_std, new_std)), parameters.changed_share):
            return informative
        informative = halves[1]
    return informative


def _sums(informative: Sequence[WindowDamper]) -> FloatArray:
    return np.array([window.sums.products for window in informative if window.sums is not None])


def _replicated(informative: Sequence[WindowDamper], parameters: DamperParameters) -> tuple[Posterior | None, float]:
    sums = _sums(informative)
    groups = np.array([group.sum(axis=0) for group in np.array_split(sums, min(len(sums), parameters.window_groups))])
    total = groups.sum(axis=0)
    curved = next(window.sums.curved for window in informative if window.sums is not None)
    overall = posterior(total, curved, parameters)
    left_out = [posterior(total - group, curved, parameters) for group in groups]
    shares = [left.share for left in left_out if left is not None]
    if overall is None or len(shares) < len(groups):
        return None, float("nan")
    return overall, float(jackknife_std(np.array([overall.share, *shares])))


@dataclass(frozen=True, slots=True)
class Posterior:
    """Mean and std of the share, and the mean square of the other parameters' errors over their stds."""

    share: float
    std: float
    errors: float
    parameters: int  # beside the share


def posterior(sums: FloatArray, curved: int, parameters: DamperParameters) -> Posterior | None:
    """Return the posterior of the share; None where sensor noise alone explains the sums."""
    count = parameters.shares_between
    fraction = (np.arange(count) + 0.5) / count
    low, step = np.array(SHARES[:-1]), np.diff(SHARES)
    share = (low[:, None] + step[:, None] * fraction).ravel()
    products, between = np.repeat(sums, count, axis=0), np.tile(fraction, len(low))
    conditional = _conditional(products, between, curved, parameters)
    if conditional is None:
        return None
    errors, square, precision = conditional
    likelihood = -0.5 * (square + np.linalg.slogdet(precision)[1])
    widths = np.repeat(step, count)
    weight = np.exp(likelihood - likelihood.max()) * widths
    weight /= weight.sum()
    mean = float(weight @ share)
    spread = float(weight @ (share - mean) ** 2) + float(weight @ widths / count) ** 2 / 12.0
    return Posterior(mean, float(np.sqrt(spread)), float(weight @ (errors**2).mean(axis=1)), errors.shape[1])


def _conditional(
    products: FloatArray, between: FloatArray, curved: int, parameters: DamperParameters
) -> tuple[FloatArray, FloatArray, FloatArray] | None:
    """Return the likeliest errors (n, k) of the other parameters given a share, their square and precision."""
    # Gauss-Newton: the effect of an error is linear; that of the first ``curved`` ones has a quadratic term as well
    n, m, _ = products.shape
    k = m - 2 - curved
    errors, rows = np.zeros((n, k)), np.arange(curved)
    for _ in range(parameters.newton_rounds):
        signals = np.concatenate([np.ones((n, 1)), errors, errors[:, :curved] ** 2, between[:, None]], axis=1)
        changes = np.zeros((n, m, k))
        changes[:, 1 : 1 + k] = np.eye(k)
        changes[:, 1 + k + rows, rows] = 2.0 * errors[:, :curved]
        residual_products = np.einsum("nab,nb->na", products, signals)
        precision = changes.transpose(0, 2, 1) @ products @ changes + np.eye(k)
        if np.linalg.eigvalsh(precision)[:, 0].min() < parameters.least_curvature:
            return None
        gradient = np.einsum("nak,na->nk", changes, residual_products) + errors
        farthest = parameters.farthest_stds
        errors = np.clip(errors - np.linalg.solve(precision, gradient[..., None])[..., 0], -farthest, farthest)
    signals = np.concatenate([np.ones((n, 1)), errors, errors[:, :curved] ** 2, between[:, None]], axis=1)
    square = np.einsum("na,nab,nb->n", signals, products, signals) + (errors**2).sum(axis=1)
    return errors, square, precision
