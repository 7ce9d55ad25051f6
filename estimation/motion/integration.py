"""Accelerations of a window integrated once and twice, segment by segment; done once and handed on.

A lateral accelerometer that rolls by phi measures y'' + g phi; where it does, the roll of the wheelset is taken out.

Which lateral displacement the rolling radius difference is looked up by: that of EN 15302.

The wheelset of EN 15302 does not roll. One in motion rolls by phi_c where its contact moves. Turned about the centre of
curvature of the rail head under its contact, rho below the top of the rail, a wheel keeps its contact; so the contact
of a wheelset that rolls is that of one that does not, displaced by what it is displaced at *that* height:

    y_EN = x + (r0 + rho) phi_c        x of the axle relative to the track, r0 above the rails

Sensors are at the height of the axle. On a track that rolls by phi_t the axle stands r0 phi_t beside the middle of the
rails, to the low side, and the roll sensor measures phi = phi_t + phi_c, so that

    y_EN = (y - d) + r0 phi + rho phi_c

The first two terms are measured. The last is too where the track does not roll. Where it may, it is hidden behind the
roll of the track, and taken as a share of the displacement that most profiles have; ``geometry.sharpening`` puts
what the curve says in its place. The equations of motion go on in the displacement of the axle.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace
from typing import Self

import numpy as np

from estimation.compiled import compiled
from estimation.errors import ParameterError
from estimation.filters import remove_wander
from estimation.motion.parameters import MOTION
from estimation.values.arrays import BoolArray, FloatArray
from estimation.values.units import GRAVITY
from estimation.values.windows import ACCELERATIONS, Window
from estimation.vehicle.parameters import VEHICLE
from estimation.vehicle.vehicle_class import VehicleClass, VehicleParameters, usable_cutoff


@dataclass(frozen=True, slots=True)
class SignalParameters:
    """How windows become motion."""

    cutoff_wavelength: float = 40.0  # m; of longer ones less than half is left
    bridged_samples: int = 3  # gaps up to this long are bridged for the integrals, never used as samples
    modelled_gap_s: float = 0.25  # gaps up to this long do not end a segment of motion: their integrals are solved for
    gap_margin_s: float = 0.5  # on both sides of a modelled gap, where that takes some of the motion too
    shortest_segment_s: float = 10.0
    trimmed_s: float = 1.0  # at each end of a segment, where the high-pass sees one side only
    least_speed_m_s: float = 8.0
    sharpest_curvature: float = 5e-5  # 1/m: shifts the wheelset by a third of a bin at conicity 0.2
    highest_cant: float = 0.02  # m
    curve_margin: float = 30.0  # m kept from sharper curves; positions and registers are off by some
    max_cant_deficiency_change: float = 0.1  # m/s2, of the slow lateral acceleration; drift on straight is less
    least_used: float = 0.1  # of a window's samples
    block_s: float = 20.0

    def __post_init__(self) -> None:
        for item in fields(self):
            value = getattr(self, item.name)
            if not value >= 0:
                raise ParameterError(f"{value!r} is negative", field=item.name)
        if not self.cutoff_wavelength > 0:
            raise ParameterError("must be positive", field="cutoff_wavelength")

    @property
    def source(self) -> str:
        """Where the motion of a bin table came from, for its key."""
        return "band-limited " + " ".join(f"{item.name}={getattr(self, item.name)}" for item in fields(self))


@dataclass(frozen=True, slots=True)
class Gates:
    """When a window may be estimated at all."""

    least_coverage: float = 0.25
    most_clipped: float = 0.1  # clipped samples are left out; with more than this the window is refused
    most_clipped_in_blows: float = 0.002  # the same of a wheel with a flat: some in every turn leave nothing whole
    least_position_quality: float = 0.1


@dataclass(frozen=True, slots=True)
class WindowParameters:
    """What turns a window into motion: the class of its vehicle, the filters, and the gates.

    The nominal radius of ``vehicle_class`` is that of the wheelset of the window.
    """

    vehicle_class: VehicleClass
    signals: SignalParameters = field(default_factory=SignalParameters)
    gates: Gates = field(default_factory=Gates)

    @classmethod
    def of(
        cls, vehicle_class: VehicleClass, nominal_radius: float | None, signals: SignalParameters, gates: Gates
    ) -> Self:
        """Return the parameters of a wheelset; the cut-off wavelength is one at which sensors see more than noise."""
        if nominal_radius is not None:
            own = replace(vehicle_class.parameters, nominal_radius=nominal_radius)
            vehicle_class = replace(vehicle_class, parameters=own)
        cutoff = usable_cutoff(vehicle_class, signals.cutoff_wavelength)
        return cls(vehicle_class, replace(signals, cutoff_wavelength=cutoff), gates)

    @property
    def vehicle(self) -> VehicleParameters:
        """Parameters of the wheelset and its suspension."""
        return self.vehicle_class.parameters


@compiled(nogil=True)
def take_out_mean(rows: FloatArray) -> None:
    """Take its mean from each of the rows (m, n)."""
    n = rows.shape[1]
    for r in range(len(rows)):
        total = 0.0
        for i in range(n):
            total += rows[r, i]
        mean = total / n
        for i in range(n):
            rows[r, i] -= mean


@compiled(nogil=True)
def integrate_once(values: FloatArray, dt: float, integral: FloatArray) -> None:
    """Write the running integral (n,) of values (n,)."""
    total, half = 0.0, 0.5 * dt
    integral[0] = 0.0
    for i in range(1, len(values)):
        total += half * (values[i] + values[i - 1])
        integral[i] = total


@compiled(nogil=True)
def integrate_twice(accelerations: FloatArray, dt: float, rates: FloatArray, displacements: FloatArray) -> None:
    """Write running integrals (m, n) of the rows, less their mean and straight line, and the integrals of those."""
    n, half = accelerations.shape[1], 0.5 * dt
    middle = 0.5 * (n - 1)
    squares = n * (n * n - 1.0) / 12.0  # of the places around the middle
    for r in range(len(accelerations)):
        rate, total, moment = 0.0, 0.0, 0.0
        rates[r, 0] = 0.0
        for i in range(1, n):
            rate += half * (accelerations[r, i] + accelerations[r, i - 1])
            rates[r, i] = rate
            total += rate
            moment += rate * (i - middle)
        mean, slope = total / n, moment / squares
        displacement, before = 0.0, 0.0
        for i in range(n):
            rate = rates[r, i] - mean - slope * (i - middle)
            if i > 0:
                displacement += half * (rate + before)
            rates[r, i], displacements[r, i], before = rate, displacement, rate


@dataclass(frozen=True, slots=True)
class IntegratedSegment:
    """Signals of one segment of m samples; the rows of (4, m) arrays are in the order of ``ACCELERATIONS``.

    Means, and straight lines of the rates, are taken out on the way, so that what still wanders is small; the slow
    part of rates and displacements carries no meaning.
    """

    part: slice  # of the window
    known: BoolArray  # (m,) samples that can be used; straight lines bridge the others
    speed: FloatArray  # (m,) V, m/s
    run: FloatArray  # (m,) m run since the start of the segment
    accelerations: FloatArray  # (4, m) m/s2 and rad/s2
    rates: FloatArray  # (4, m) m/s and rad/s
    displacements: FloatArray  # (4, m) m and rad
    frame_yaw: FloatArray | None = None  # (3, m) rad/s2, rad/s, rad: of the bogie frame; None without a bogie
    level: bool = False  # gravity has been taken out of the lateral signals: the track may roll


@dataclass(frozen=True, slots=True)
class IntegratedWindow:
    """The segments of a window, in order of time."""

    window: Window
    segments: tuple[IntegratedSegment, ...]


def integrate(
    window: Window,
    usable: BoolArray,
    parameters: SignalParameters,
    longest_gap: int | None = None,
    earlier: IntegratedWindow | None = None,
) -> IntegratedWindow:
    """Return the segments of usable samples, integrated.

    Args:
        longest_gap: Samples that may be missing in a row within a segment; by default as many as may be bridged.
        earlier: The same accelerations and speeds, integrated before; segments of the same samples are taken from it.
    """
    done = {} if earlier is None else {(item.part.start, item.part.stop): item for item in earlier.segments}
    found = []
    for start, stop in segments(usable, window, parameters, longest_gap):
        known = np.asarray(usable[start:stop])
        item = done.get((start, stop))
        if item is None or not np.array_equal(item.known, known):
            item = _integrated(window, known, slice(start, stop))
        found.append(item)
    return IntegratedWindow(window, tuple(found))


def mirrored(integrated: IntegratedWindow) -> IntegratedWindow:
    """Return the mirror image: every acceleration, and what was integrated from it, with the opposite sign."""
    window = integrated.window
    return IntegratedWindow(
        replace(
            window,
            frame_yaw_acceleration=_negative(window.frame_yaw_acceleration),
            **{name: -getattr(window, name) for name in ACCELERATIONS},
        ),
        tuple(
            replace(
                item,
                accelerations=-item.accelerations,
                rates=-item.rates,
                displacements=-item.displacements,
                frame_yaw=_negative(item.frame_yaw),
            )
            for item in integrated.segments
        ),
    )


def _negative(values: FloatArray | None) -> FloatArray | None:
    return None if values is None else -values


def segments(
    usable: BoolArray, window: Window, parameters: SignalParameters, longest_gap: int | None = None
) -> list[tuple[int, int]]:
    """Return the runs ``[start, stop)`` of usable samples with only short gaps in them that are long enough."""
    gap = parameters.bridged_samples if longest_gap is None else longest_gap
    index = np.flatnonzero(usable)
    breaks = np.flatnonzero(np.diff(index) > gap + 1)
    starts = np.concatenate([index[:1], index[breaks + 1]])
    stops = np.concatenate([index[breaks], index[-1:]]) + 1
    least = parameters.shortest_segment_s / window.sample_interval_s
    return [(int(a), int(b)) for a, b in zip(starts, stops, strict=True) if b - a >= least]


def bridged(values: FloatArray, known: BoolArray) -> FloatArray:
    """Return ``values`` (n,) with straight lines across the samples that are not ``known`` (n,), in any unit."""
    if known.all():
        return values
    t = np.arange(len(values))
    return np.interp(t, t[known], values[known])


def _integrated(window: Window, known: BoolArray, part: slice) -> IntegratedSegment:
    dt = window.sample_interval_s
    measured = [getattr(window, name) for name in ACCELERATIONS]
    if window.frame_yaw_acceleration is not None:
        measured.append(window.frame_yaw_acceleration)
    accelerations = np.stack([bridged(values[part], known) for values in measured])
    take_out_mean(accelerations)
    rates, displacements = np.empty_like(accelerations), np.empty_like(accelerations)
    integrate_twice(accelerations, dt, rates, displacements)
    speed = np.array(bridged(window.speed[part], known))
    run = np.empty_like(speed)
    integrate_once(speed, dt, run)
    if window.measures_gravity:
        (roll,) = remove_wander(displacements[[_ROLL]], run, known, MOTION.longest_roll_wave)
        lateral = accelerations[_LATERAL] - GRAVITY * roll
        lateral_rates, lateral_displacements = np.empty_like(lateral), np.empty_like(lateral)
        integrate_twice(lateral, dt, lateral_rates, lateral_displacements)
        accelerations[_LATERAL], rates[_LATERAL] = lateral, lateral_rates
        displacements[_LATERAL] = lateral_displacements
    own = slice(0, len(ACCELERATIONS))
    of_frame = [values[-1] for values in (accelerations, rates, displacements)]
    return IntegratedSegment(
        part,
        known,
        speed,
        run,
        accelerations[own],
        rates[own],
        displacements[own],
        None if window.frame_yaw_acceleration is None else np.stack(of_frame),
        window.measures_gravity,
    )


_ROLL = ACCELERATIONS.index("roll_acceleration")
_LATERAL = [ACCELERATIONS.index("lateral_acceleration"), ACCELERATIONS.index("mass_lateral_acceleration")]


def standard_displacement(displacement: FloatArray, roll: FloatArray, radius: float, *, level: bool) -> FloatArray:
    """Return the displacement (n,), m, relative to the track, that EN 15302 means.

    Args:
        displacement: (n,) y - d, m, at the height of the axle.
        level: Whether gravity has been taken out of the lateral signals: the track may roll.
    """
    seen = observed_displacement(displacement, roll, radius, level=level)
    return seen * (1.0 + MOTION.hidden_roll_share) if level else seen


def observed_displacement(displacement: FloatArray, roll: FloatArray, radius: float, *, level: bool) -> FloatArray:
    """Return the same (n,), m, as far as it is measured; for a displacement from which no alignment is taken off."""
    height = radius if level else radius + VEHICLE.rail_head_radius
    return displacement + height * roll
