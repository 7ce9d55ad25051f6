"""What one window of a running gear says of its lateral damper: the products of its particles' innovations.

The noise of the wheelsets' sensors is in what the filters take for their input, and would pull their parameters. What
noise as on file adds to the products is known, and is taken off (bias-compensated least squares).

The damper of a running gear from the sums of its windows: posterior over particles, interval, finding.

Given a share of the damping the other parameters of the vehicle are linear in the innovations: their errors, of which
the class states the standard deviations, are solved for in every particle (Rao and Blackwell), and leave their part in
its weight. What windows tell beyond that is seen from leaving groups of them out.
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
from estimation.values.opinions import SHARES, DamperSums, GearDamper, WindowDamper
from estimation.values.quantities import Estimate, Status, jackknife_std, with_interval
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.units import NORMAL_95
from estimation.values.windows import Window
from estimation.vehicle.vehicle_class import ClassOnFile, VehicleClass


def looked_at(first: Window) -> bool:
    """Return whether the damper is looked at in a window: one of ``window_stride``, whatever others there are."""
    # Its start is mixed first, so that no recorder that runs at regular times is always left out. Both running gears of
    # a vehicle are looked at in the same windows.
    return zlib.crc32(f"{first.vehicle} {first.start_ns // first.length_ns}".encode()) % DAMPING.window_stride == 0


def window_damper(
    first: Window, content_digest: str, gear: GearSegments | Reason, on_file: ClassOnFile
) -> WindowDamper:
    """Return what a window says of the damper of a running gear, or why it says nothing."""
    vehicle_class = on_file.vehicle_class
    found, innovation = (gear, None) if isinstance(gear, Reason) else _window_sums(gear, vehicle_class)
    return WindowDamper(
        vehicle=first.vehicle,
        first_axle=first.axle,
        wheelset=first.wheelset,
        start_ns=first.start_ns,
        odometer_km=1e-3 * first.odometer_m,
        content_digest=content_digest,
        class_digest=on_file.digest,
        mass_std=mass_std(vehicle_class),
        innovation=innovation,
        sums=None if isinstance(found, Reason) else found,
        reason=found if isinstance(found, Reason) else None,
    )


def _window_sums(gear: GearSegments, vehicle_class: VehicleClass) -> tuple[DamperSums | Reason, float | None]:
    """Return the sums of a window, or why there are none."""
    # beside them the mean square of the innovations over the largest that is believed
    refused = not_judged(vehicle_class)
    if refused is not None:
        return refused, None
    filters = damper_filters(vehicle_class, gear.sample_interval_s)
    q, v, _ = filters.measured.shape
    products = np.zeros((q - 1, v + 1, v + 1))
    count, square = 0, 0.0
    for segment in gear.segments:
        taken = _taken(segment, gear, filters.apart)
        if taken is None:
            continue
        _, above, counted = taken
        add_products(filters, *taken, products)
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
            text = f"{name} of class {vehicle_class.code!r} is known to {std:.0%} only"
            return Reason(ReasonCode.SUSPENSION_UNCERTAIN, f"{text}, at most {DAMPING.largest_std:.0%} will do")
    return None


def _taken(
    segment: GearSegment, gear: GearSegments, apart: tuple[float, float]
) -> tuple[FloatArray, FloatArray, BoolArray] | None:
    """Return accelerations below and above as ``SOURCES`` names them, (k, s) m/s2, and which samples count, (s,).

    None where the segment is too short for the filters.
    """
    axles, known, dt = gear.axles, segment.axles[0].known, gear.sample_interval_s
    stride, half = stride_of(dt), len(low_pass(dt)) // 2
    unknown = round(DAMPING.unknown_begin_s / (stride * dt))
    if len(known) - 2 * half < 2 * unknown * stride:
        return None
    signals = [segment.accelerations[: 2 * axles : 2], segment.accelerations[2 * axles :]]
    taken = [[thinned(bridged(one, known), dt) for one in rows] for rows in signals]
    (below, below_apart), (above, above_apart) = ((np.mean(rows, axis=0), 0.5 * (rows[0] - rows[-1])) for rows in taken)
    raised, raised_apart = between_samples(below), between_samples(below_apart)
    late = DAMPING.clock_std_s / (stride * dt)
    counted = known[half : len(known) - half][::stride].copy()
    counted[:unknown] = counted[-1:] = False
    of_wheelsets = [raised, raised + apart[0] * raised_apart, raised, raised + late * np.gradient(raised_apart)]
    of_above = [above, above, above + apart[1] * above_apart, above + late * np.gradient(above_apart)]
    return np.stack(of_wheelsets), np.stack(of_above), counted


def _judged(
    products: FloatArray, count: int, square: float, filters: DamperFilters
) -> tuple[DamperSums | Reason, float]:
    whole = of_signals(filters, products)
    least = min(_least(one, count) for one in whole)
    innovation = float(least) / (float(filters.noise[:, 0, 0].max()) + DAMPING.most_unexplained_share * square / count)
    if not (np.isfinite(innovation) and innovation <= 1.0):
        text = f"the innovations of the suspension's filters are {np.sqrt(innovation):.1f} times what is believed"
        return Reason(ReasonCode.DIVERGED, f"{text}; check class and sensors"), innovation
    independent = count * min(2.0 * DAMPING.pass_hz * filters.step_s, 1.0)
    scale = independent / (count * least + DAMPING.model_error**2 * square)
    excited = _excitation(whole * scale, count * scale * filters.noise)
    if not excited > DAMPING.least_excitation:
        text = f"the motion shows the damper {max(excited, 0.0):.1f} times as much as noise does"
        return Reason(
            ReasonCode.DAMPER_NOT_EXCITED, f"{text}, {DAMPING.least_excitation:g} times are needed"
        ), innovation
    return DamperSums((whole - count * filters.noise) * scale, independent, filters.curved), innovation


def _excitation(products: FloatArray, noise: FloatArray) -> float:
    """Return what motion makes of the part that only the damper explains over what noise makes of it."""
    # Least over the particles. That part is the change from one particle to the next without what others explain of it.
    others = products[:, 1:-1, 1:-1] + np.eye(products.shape[-1] - 2)
    explained = np.linalg.solve(others, products[:, 1:-1, -1:])[..., 0]
    direction = np.concatenate([-explained, np.ones((len(products), 1))], axis=1)
    inner = slice(1, None)
    whole, of_noise = (np.einsum("pa,pab,pb->p", direction, m[:, inner, inner], direction) for m in (products, noise))
    return float((whole / of_noise).min() - 1.0)


def _least(products: FloatArray, count: int) -> float:
    size = len(products) - 1
    ridge = np.diag(np.full(size, 0.25 * products[0, 0] / count))
    best = np.linalg.solve(products[1:, 1:] + ridge, -products[1:, 0])
    signal = np.append(1.0, np.clip(best, -2.0, 2.0))
    return float(signal @ products @ signal) / count


@dataclass(frozen=True, slots=True)
class DamperParameters:
    """How far back windows count, and what is published."""

    span_km: float = 5_000.0  # of the odometer, back from the newest window
    weak_share: float = 0.5  # a damper with less of its damping is weak
    likely: float = 0.9  # probability of that from which on it is a finding
    widest_std: float = 0.2  # of a share that is published
    most_diverged: float = 0.2  # share of the windows
    surest: float = 0.99  # probability at which errors of the other parameters exceed those of any vehicle
    shares_between: int = 16  # shares at which the posterior is, from one particle to the next
    window_groups: int = 12  # of windows that are left out together
    fewest_windows: int = 4  # windows
    largest_share: float = 1.9  # the particles end at 2
    apart_stds: float = 3.0  # standard deviations between two halves of the windows that do not belong together
    changed_share: float = 0.1  # of the share, which halves differ by at least then
    model_share_std: float = 0.05  # of a share, by cross level, clocks and scales of nodes; docs/results/dampers.md
    least_share_std: float = 0.01  # of any share, for the same
    newton_rounds: int = 5  # of Gauss and Newton
    farthest_stds: float = 6.0  # standard deviations that they look at
    least_curvature: float = 0.2  # of the other parameters' information with priors: below it noise makes all of it


def gear_damper(windows: Sequence[WindowDamper], parameters: DamperParameters) -> GearDamper:
    """Return what the newest windows of a running gear say of its damper; in any order they say the same."""
    ordered = sorted(windows, key=lambda one: one.start_ns)
    newest = ordered[-1]
    chosen = [
        one
        for one in ordered
        if one.class_digest == newest.class_digest and newest.odometer_km - one.odometer_km <= parameters.span_km
    ]
    shown = _newest_alike([one for one in chosen if one.sums is not None], parameters)
    since = [one for one in chosen if not shown or one.start_ns >= shown[0].start_ns]
    diverged = sum(one.reason is not None and one.reason.code is ReasonCode.DIVERGED for one in since)
    share = _share(shown, diverged, newest, parameters)
    std = None if share.low is None or share.high is None else 0.5 * (share.high - share.low) / NORMAL_95
    weak = None
    if share.value is not None and std is not None:
        weak = float(ndtr((parameters.weak_share - share.value) / std))
        share = replace(share, low=max(share.value - NORMAL_95 * std, 0.0))
    first, last = (shown or since)[0], (shown or since)[-1]
    return GearDamper(
        vehicle=newest.vehicle,
        first_axle=newest.first_axle,
        share=share,
        weak_probability=weak,
        weak=None if weak is None else weak >= parameters.likely,
        windows=len(shown),
        diverged=diverged,
        refused=len(since) - len(shown) - diverged,
        from_ns=first.start_ns,
        to_ns=last.start_ns,
        from_km=first.odometer_km,
        to_km=last.odometer_km,
    )


def _share(
    shown: Sequence[WindowDamper], diverged: int, newest: WindowDamper, parameters: DamperParameters
) -> Estimate:
    count, mismatch = float(len(shown)), Status.MODEL_MISMATCH
    if diverged > parameters.most_diverged * (len(shown) + diverged):
        text = f"the filters of the suspension have diverged in {diverged} of {len(shown) + diverged} windows"
        return Estimate.unknown(Reason(ReasonCode.DIVERGED, text), count, mismatch)
    if len(shown) < parameters.fewest_windows:
        text = f"{len(shown)} windows show the suspension, {parameters.fewest_windows} are needed"
        few = Reason(ReasonCode.TOO_FEW_WINDOWS, text)
        return Estimate.unknown(few if shown or newest.reason is None else newest.reason, count)
    found, sampled = _replicated(shown, parameters)
    if found is None or not np.isfinite(sampled):
        return Estimate.unknown(_not_excited("their noise alone makes up what accelerations show"), count)
    size = found.parameters
    if found.share > parameters.largest_share or found.errors * size > float(chdtri(size, 1.0 - parameters.surest)):
        text = (
            f"a share of {found.share:.2f} with other parameters {np.sqrt(found.errors):.1f} of their standard"
            " deviations off is none of this class; check class and sensors"
        )
        return Estimate.unknown(Reason(ReasonCode.DIVERGED, text), count, mismatch)
    of_share = np.hypot(newest.mass_std, parameters.model_share_std) * found.share
    systematic = float(np.linalg.norm([found.std, of_share, parameters.least_share_std]))
    std = float(np.hypot(sampled, systematic))
    if std > parameters.widest_std:
        return Estimate.unknown(_not_excited(f"the standard deviation of its share would be {std:.2f}"), count)
    return with_interval(found.share, sampled, systematic, min(len(shown), parameters.window_groups), count)


def _not_excited(why: str) -> Reason:
    return Reason(ReasonCode.DAMPER_NOT_EXCITED, f"what is above the wheelsets does not show the damper: {why}")


def _newest_alike(shown: Sequence[WindowDamper], parameters: DamperParameters) -> Sequence[WindowDamper]:
    while len(shown) >= 4 * parameters.fewest_windows:
        halves = shown[: len(shown) // 2], shown[len(shown) // 2 :]
        (old, old_std), (new, new_std) = (_replicated(half, parameters) for half in halves)
        if old is None or new is None:
            return shown
        apart = abs(new.share - old.share)
        if not apart > max(parameters.apart_stds * float(np.hypot(old_std, new_std)), parameters.changed_share):
            return shown
        shown = halves[1]
    return shown


def _sums(shown: Sequence[WindowDamper]) -> FloatArray:
    return np.array([one.sums.products for one in shown if one.sums is not None])


def _replicated(shown: Sequence[WindowDamper], parameters: DamperParameters) -> tuple[Posterior | None, float]:
    sums = _sums(shown)
    groups = np.array([part.sum(axis=0) for part in np.array_split(sums, min(len(sums), parameters.window_groups))])
    total = groups.sum(axis=0)
    curved = next(one.sums.curved for one in shown if one.sums is not None)
    found = posterior(total, curved, parameters)
    left_out = [posterior(total - group, curved, parameters) for group in groups]
    shares = [one.share for one in left_out if one is not None]
    if found is None or len(shares) < len(groups):
        return None, float("nan")
    return found, float(jackknife_std(np.array([found.share, *shares])))


@dataclass(frozen=True, slots=True)
class Posterior:
    """What sums say: mean and std of the share, and the mean square of the other parameters' errors over their stds."""

    share: float
    std: float
    errors: float
    parameters: int  # beside the share


def posterior(sums: FloatArray, curved: int, parameters: DamperParameters) -> Posterior | None:
    """Return what sums say; None where the noise of the sensors would make up all of it."""
    count = parameters.shares_between
    t = (np.arange(count) + 0.5) / count
    low, apart = np.array(SHARES[:-1]), np.diff(SHARES)
    share = (low[:, None] + apart[:, None] * t).ravel()
    products, between = np.repeat(sums, count, axis=0), np.tile(t, len(low))
    found = _conditional(products, between, curved, parameters)
    if found is None:
        return None
    errors, square, precision = found
    likelihood = -0.5 * (square + np.linalg.slogdet(precision)[1])
    widths = np.repeat(apart, count)
    weight = np.exp(likelihood - likelihood.max()) * widths
    weight /= weight.sum()
    mean = float(weight @ share)
    spread = float(weight @ (share - mean) ** 2) + float(weight @ widths / count) ** 2 / 12.0
    return Posterior(mean, float(np.sqrt(spread)), float(weight @ (errors**2).mean(axis=1)), errors.shape[1])


def _conditional(
    products: FloatArray, between: FloatArray, curved: int, parameters: DamperParameters
) -> tuple[FloatArray, FloatArray, FloatArray] | None:
    """Return the errors (n, k) of the other parameters that are likeliest given a share, their square and precision."""
    # By Gauss and Newton: their effect has a first and, for the first of them, a second order
    n, m, _ = products.shape
    k = m - 2 - curved
    errors, rows = np.zeros((n, k)), np.arange(curved)
    for _ in range(parameters.newton_rounds):
        signals = np.concatenate([np.ones((n, 1)), errors, errors[:, :curved] ** 2, between[:, None]], axis=1)
        changes = np.zeros((n, m, k))
        changes[:, 1 : 1 + k] = np.eye(k)
        changes[:, 1 + k + rows, rows] = 2.0 * errors[:, :curved]
        left = np.einsum("nab,nb->na", products, signals)
        precision = changes.transpose(0, 2, 1) @ products @ changes + np.eye(k)
        if np.linalg.eigvalsh(precision)[:, 0].min() < parameters.least_curvature:
            return None
        gradient = np.einsum("nak,na->nk", changes, left) + errors
        farthest = parameters.farthest_stds
        errors = np.clip(errors - np.linalg.solve(precision, gradient[..., None])[..., 0], -farthest, farthest)
    signals = np.concatenate([np.ones((n, 1)), errors, errors[:, :curved] ** 2, between[:, None]], axis=1)
    square = np.einsum("na,nab,nb->n", signals, products, signals) + (errors**2).sum(axis=1)
    return errors, square, precision
