"""What one window of a running gear says of its lateral damper: the products of its particles' innovations.

The noise of the wheelsets' sensors is in what the filters take for their input, and would pull their parameters. What
noise as on file adds to the products is known, and is taken off (bias-compensated least squares).
"""

from __future__ import annotations

import zlib

import numpy as np

from estimation.adhesion.creep_forces import GearSegment, GearSegments
from estimation.dampers.damper_filters import LATE_STD_S, DamperFilters, add_products, damper_filters, of_signals
from estimation.dampers.suspension_equations import (
    PASSED_HZ,
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
from estimation.values.opinions import DamperSums, WindowDamper
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.windows import Window
from estimation.vehicle.vehicle_class import ClassOnFile, VehicleClass

UNKNOWN_S = 6.0  # at the begin of a segment, whose deflections are not known
MODEL_ERROR = 0.02  # of the acceleration above, that stiff bodies do not explain whatever their parameters
LEAST_EXCITATION = 3.0  # what motion shows of the damper over what noise does
FEWEST_SAMPLES = 600.0  # of a window that are counted: 10 s
MOST_UNEXPLAINED = 0.05  # mean square of the innovations beside noise, over that of the acceleration above
EVERY = 3  # windows, one of which is looked at: a damper changes over months
LARGEST_STD = 0.3  # relative, of parameters beside the damper: beyond it their effect is not proportional


def looked_at(first: Window) -> bool:
    """Return whether the damper is looked at in a window: in one of ``EVERY``, whatever others there are.

    Its start is mixed first, so that no recorder that runs at regular times is always left out. Both running gears of a
    vehicle are looked at in the same windows.
    """
    return zlib.crc32(f"{first.vehicle} {first.start_ns // first.length_ns}".encode()) % EVERY == 0


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
    """Return the sums of a window, or why there are none.

    Beside them the mean square of the innovations over the largest that is believed.
    """
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
    if count < FEWEST_SAMPLES:
        return Reason(ReasonCode.TOO_FEW_USABLE, f"{count} samples of deflections are known"), None
    return _judged(products, count, square, filters)


def not_judged(vehicle_class: VehicleClass) -> Reason | None:
    """Return why the damper of a class cannot be judged; None where it can."""
    if not nominal_damping(vehicle_class) > 0.0:
        return Reason(ReasonCode.DAMPER_NOT_ON_FILE, f"class {vehicle_class.code!r} has no lateral damper on file")
    for name, std in uncertain_parameters(vehicle_class).items():
        if std > LARGEST_STD:
            text = f"{name} of class {vehicle_class.code!r} is known to {std:.0%} only"
            return Reason(ReasonCode.SUSPENSION_UNCERTAIN, f"{text}, at most {LARGEST_STD:.0%} will do")
    return None


def _taken(
    segment: GearSegment, gear: GearSegments, apart: tuple[float, float]
) -> tuple[FloatArray, FloatArray, BoolArray] | None:
    """Return accelerations below and above as ``SOURCES`` names them, (k, s) m/s2, and which samples count, (s,).

    None where the segment is too short for the filters.
    """
    axles, known, dt = gear.axles, segment.axles[0].known, gear.sample_interval_s
    stride, half = stride_of(dt), len(low_pass(dt)) // 2
    unknown = round(UNKNOWN_S / (stride * dt))
    if len(known) - 2 * half < 2 * unknown * stride:
        return None
    signals = [segment.accelerations[: 2 * axles : 2], segment.accelerations[2 * axles :]]
    taken = [[thinned(bridged(one, known), dt) for one in rows] for rows in signals]
    (below, below_apart), (above, above_apart) = ((np.mean(rows, axis=0), 0.5 * (rows[0] - rows[-1])) for rows in taken)
    raised, raised_apart = between_samples(below), between_samples(below_apart)
    late = LATE_STD_S / (stride * dt)
    counted = known[half : len(known) - half][::stride].copy()
    counted[:unknown] = counted[-1:] = False
    of_wheelsets = [raised, raised + apart[0] * raised_apart, raised, raised + late * np.gradient(raised_apart)]
    of_above = [above, above, above + apart[1] * above_apart, above + late * np.gradient(above_apart)]
    return np.stack(of_wheelsets), np.stack(of_above), counted


def _judged(
    products: FloatArray, count: int, square: float, filters: DamperFilters
) -> tuple[DamperSums | Reason, float]:
    """Return sums over the mean square of what the best particle does not explain, where its filter has followed."""
    whole = of_signals(filters, products)
    least = min(_least(one, count) for one in whole)
    innovation = float(least) / (float(filters.noise[:, 0, 0].max()) + MOST_UNEXPLAINED * square / count)
    if not (np.isfinite(innovation) and innovation <= 1.0):
        text = f"the innovations of the suspension's filters are {np.sqrt(innovation):.1f} times what is believed"
        return Reason(ReasonCode.DIVERGED, f"{text}; check class and sensors"), innovation
    independent = count * min(2.0 * PASSED_HZ * filters.step_s, 1.0)
    scale = independent / (count * least + MODEL_ERROR**2 * square)
    excited = _excitation(whole * scale, count * scale * filters.noise)
    if not excited > LEAST_EXCITATION:
        text = f"the motion shows the damper {max(excited, 0.0):.1f} times as much as noise does"
        return Reason(ReasonCode.DAMPER_NOT_EXCITED, f"{text}, {LEAST_EXCITATION:g} times are needed"), innovation
    return DamperSums((whole - count * filters.noise) * scale, independent, filters.curved), innovation


def _excitation(products: FloatArray, noise: FloatArray) -> float:
    """Return what motion makes of the part that only the damper explains over what noise makes of it.

    Least over the particles. That part is the change from one particle to the next without what others explain of it.
    """
    others = products[:, 1:-1, 1:-1] + np.eye(products.shape[-1] - 2)
    explained = np.linalg.solve(others, products[:, 1:-1, -1:])[..., 0]
    direction = np.concatenate([-explained, np.ones((len(products), 1))], axis=1)
    inner = slice(1, None)
    whole, of_noise = (np.einsum("pa,pab,pb->p", direction, m[:, inner, inner], direction) for m in (products, noise))
    return float((whole / of_noise).min() - 1.0)


def _least(products: FloatArray, count: int) -> float:
    """Return the least mean square of a particle's innovations that parameters within two stds make."""
    size = len(products) - 1
    ridge = np.diag(np.full(size, 0.25 * products[0, 0] / count))
    best = np.linalg.solve(products[1:, 1:] + ridge, -products[1:, 0])
    signal = np.append(1.0, np.clip(best, -2.0, 2.0))
    return float(signal @ products @ signal) / count
