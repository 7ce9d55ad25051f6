"""One stationary Kalman filter for each particle over the damping, and for each parameter that is uncertain beside it.

Particles do not move: a damper does not change within a window, and what windows say at the same shares adds up. So
the filters of a class are made once. States are the deflections of ``suspension_equations`` and the offset between the
sensors above and those of the wheelsets, a random walk; the noise of the wheelsets' sensors drives the deflections.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Annotated

import numpy as np
import scipy.linalg

from estimation.adhesion.stationary_filter import over_a_sample
from estimation.compiled import compiled
from estimation.dampers.parameters import DAMPING
from estimation.dampers.suspension_equations import (
    between_samples,
    low_pass,
    stride_of,
    suspension_equations,
    uncertain_parameters,
)
from estimation.values.arrays import BoolArray, FloatArray, FrozenArrays, IntArray, frozen_array
from estimation.values.memory import MEMORY
from estimation.values.sums import SHARES
from estimation.vehicle.vehicle_class import AXLES_OF_A_BOGIE, SensorLayout, VehicleClass


@compiled(nogil=True)
def add_innovation_products(
    transition: FloatArray,
    by_input: FloatArray,
    measured: FloatArray,
    gain: FloatArray,
    source: IntArray,
    below: FloatArray,
    above: FloatArray,
    counted: BoolArray,
    products: FloatArray,
) -> None:
    """Add the products of the innovations over a segment, its filters beginning at zero.

    Args:
        transition, by_input, measured, gain: (q, v, n, n), (q, v, 2, n), (q, v, n) and (q, v, n) of the filters.
        source: (v,) which row of the accelerations each variant takes.
        below, above: (k, s) accelerations of the wheelsets and of what is above them, m/s2.
        products: (q - 1, v + 1, v + 1) of the innovations of a particle's variants, and of the next particle's first;
            added to.
    """
    q, v, n = measured.shape
    size = q * v
    # filters side by side: every sum of each goes in the order of its terms
    of_states, of_inputs = np.zeros((n, n, size)), np.zeros((2, n, size))
    weights, gains = np.zeros((n, size)), np.zeros((n, size))
    for particle in range(q):
        for variant in range(v):
            one = particle * v + variant
            for k in range(n):
                weights[k, one], gains[k, one] = measured[particle, variant, k], gain[particle, variant, k]
                for row in range(2):
                    of_inputs[row, k, one] = by_input[particle, variant, row, k]
                for j in range(n):
                    of_states[k, j, one] = transition[particle, variant, k, j]
    state, corrected = np.zeros((n, size)), np.zeros((n, size))
    now, then, innovation = np.zeros(size), np.zeros(size), np.zeros(size)
    signals = np.zeros(v + 1)
    for i in range(below.shape[1] - 1):
        for particle in range(q):
            for variant in range(v):
                one, row = particle * v + variant, source[variant]
                now[one], then[one], innovation[one] = below[row, i], below[row, i + 1], above[row, i]
        step(of_states, of_inputs, weights, gains, now, then, innovation, state, corrected)
        if counted[i]:
            add_outer(innovation.reshape(q, v), signals, products)


@compiled(nogil=True)
def step(
    of_states: FloatArray,
    of_inputs: FloatArray,
    weights: FloatArray,
    gains: FloatArray,
    now: FloatArray,
    then: FloatArray,
    innovation: FloatArray,
    state: FloatArray,
    corrected: FloatArray,
) -> None:
    """Take f filters on by a sample.

    Args:
        of_states, of_inputs, weights, gains: (n, n, f), (2, n, f), (n, f) and (n, f): transition, inputs, measurement
            and gain of the filters.
        now, then: (f,) accelerations of the wheelsets at this sample and at the next, m/s2.
        innovation: (f,) accelerations of what is above at this one, m/s2; changed to the innovations.
    """
    n, f = state.shape
    for k in range(n):
        for one in range(f):
            innovation[one] -= weights[k, one] * state[k, one]
    for k in range(n):
        for one in range(f):
            corrected[k, one] = state[k, one] + gains[k, one] * innovation[one]
    for k in range(n):
        for one in range(f):
            state[k, one] = of_inputs[0, k, one] * now[one] + of_inputs[1, k, one] * then[one]
        for j in range(n):
            for one in range(f):
                state[k, one] += of_states[k, j, one] * corrected[j, one]


@compiled(nogil=True)
def add_outer(innovations: FloatArray, signals: FloatArray, products: FloatArray) -> None:
    """Add the products of the innovations of a sample to the lower half of every particle's."""
    q, v = innovations.shape
    for particle in range(q - 1):
        for variant in range(v):
            signals[variant] = innovations[particle, variant]
        signals[v] = innovations[particle + 1, 0]
        for a in range(v + 1):
            for b in range(a + 1):
                products[particle, a, b] += signals[a] * signals[b]


GAIN = "gain"  # of the sensors above over those of the wheelsets
SOURCES = ("mean", "apart_below", "apart_above", "late")
"""Accelerations that filters take: means of both axles; of sensors with scales apart; of nodes with clocks apart."""


@dataclass(frozen=True, slots=True)
class DamperFilters(FrozenArrays):
    """Filters of q particles and 1 + v variants of each: as on file, then with one thing off by one std.

    Masses and springs are off to both sides, so that their effect is known to the second order.
    """

    transition: Annotated[FloatArray, "q", "v", "n", "n"]  # over a sample
    by_input: Annotated[FloatArray, "q", "v", 2, "n"]  # by the input at its begin and its end
    measured: Annotated[FloatArray, "q", "v", "n"]
    gain: Annotated[FloatArray, "q", "v", "n"]
    source: Annotated[IntArray, "v"]  # which of ``SOURCES`` each takes
    apart: tuple[float, float]  # std of half the difference of two sensors' scales, below and above
    step_s: float  # between the samples that they take
    signals: Annotated[FloatArray, "m", "v + 1"]  # innovations of a particle's variants, and the next particle's first
    curved: int  # parameters whose effect has a second order, p
    noise: Annotated[FloatArray, "q - 1", "m", "m"]  # what the sensors' noise adds to the products in a sample


def damper_filters(vehicle_class: VehicleClass, sample_interval_s: float) -> DamperFilters:
    """Return the filters of a class; a LinAlgError where it has no stationary one."""
    return _filters(_Kept(vehicle_class), sample_interval_s)


@dataclass(frozen=True, slots=True)
class _Kept:
    vehicle_class: VehicleClass

    def __hash__(self) -> int:
        return hash((self.vehicle_class.parameters, self.vehicle_class.bogie, self.vehicle_class.sensors))


@lru_cache(maxsize=MEMORY.damper_filters)
def _filters(kept: _Kept, sample_interval_s: float) -> DamperFilters:
    vehicle_class, step_s = kept.vehicle_class, stride_of(sample_interval_s) * sample_interval_s
    physical = uncertain_parameters(vehicle_class)
    variants: list[Mapping[str, float]] = [{}]
    variants += [{name: sign * std} for sign in (1.0, -1.0) for name, std in physical.items()]
    variants += [{GAIN: gain_std(vehicle_class)}]
    sources = [0] * len(variants)
    if vehicle_class.bogie is not None:
        variants, sources = [*variants, {}, {}, {}], [*sources, 1, 2, 3]
    made = [[_one(vehicle_class, share, variant, step_s) for variant in variants] for share in SHARES]
    transition, by_input, measured, gain = (np.array([[parts[k] for parts in row] for row in made]) for k in range(4))
    apart = [std / math.sqrt(2.0) for std in _scale_stds(vehicle_class.sensors)]
    signals = _signals(len(physical), len(sources))
    size = len(signals)
    filters = DamperFilters(
        transition=transition,
        by_input=by_input,
        measured=measured,
        gain=gain,
        source=np.array(sources),
        apart=(apart[0], apart[1]),
        step_s=step_s,
        signals=signals,
        curved=len(physical),
        noise=np.zeros((len(SHARES) - 1, size, size)),
    )
    return replace(filters, noise=_of_noise(filters, vehicle_class, sample_interval_s))


def _signals(physical: int, variants: int) -> FloatArray:
    """Return what signals are made of (m, variants + 1): half differences of two variants, half second ones."""
    nominal, following = 0, variants
    rows = [np.eye(variants + 1)[nominal]]
    plus, minus = (np.eye(variants + 1)[1 + k * physical : 1 + (k + 1) * physical] for k in (0, 1))
    rows += list(0.5 * (plus - minus))
    rows += [row - rows[0] for row in np.eye(variants + 1)[1 + 2 * physical : variants]]
    rows += list(0.5 * (plus + minus) - rows[0])
    return np.stack([*rows, np.eye(variants + 1)[following] - rows[0]])


def _of_noise(filters: DamperFilters, vehicle_class: VehicleClass, dt: float) -> FloatArray:
    """Return what the noise of the sensors adds to the products of a sample on average, (q - 1, v + 2, v + 2)."""
    stride, taps = stride_of(dt), low_pass(dt)
    count = round(DAMPING.memory_s / filters.step_s)
    variants = len(filters.source) + 1
    products = np.zeros((len(SHARES) - 1, variants, variants))
    counted, silent = np.ones(count, np.bool_), np.zeros((len(SOURCES), count))
    for phase in range(stride):
        response = np.zeros(count)
        part = taps[phase::stride]
        response[1 : 1 + len(part)] = part
        for below in (True, False):
            std = _densities(vehicle_class.sensors, _axles(vehicle_class))[0 if below else 1] / math.sqrt(2.0 * dt)
            noise = std * (between_samples(response) if below else response)
            mean = np.tile(noise, (len(SOURCES), 1))
            apart = silent.copy()
            apart[1 if below else 2] = filters.apart[0 if below else 1] * noise
            apart[3] = DAMPING.clock_std_s * np.gradient(noise, filters.step_s)
            for signal in (mean, apart):
                both = (signal, silent) if below else (silent, signal)
                add_products(filters, both[0], both[1], counted, products)
    return of_signals(filters, products)


def of_signals(filters: DamperFilters, products: FloatArray) -> FloatArray:
    """Return the products (q - 1, m, m) of the signals."""
    whole = products + np.tril(products, -1).transpose(0, 2, 1)
    return np.asarray(filters.signals @ whole @ filters.signals.T)


def add_products(
    filters: DamperFilters, below: FloatArray, above: FloatArray, counted: BoolArray, products: FloatArray
) -> None:
    """Add the products of the innovations over a segment of accelerations (k, s), m/s2, as ``SOURCES`` names them."""
    add_innovation_products(
        filters.transition,
        filters.by_input,
        filters.measured,
        filters.gain,
        filters.source,
        frozen_array(below, (len(SOURCES), None), name="below"),
        frozen_array(above, (len(SOURCES), None), name="above"),
        frozen_array(counted, (None,), np.bool_, name="counted"),
        products,
    )


def gain_std(vehicle_class: VehicleClass) -> float:
    """Return the relative std of the scale of the sensors above over that of the wheelsets'."""
    return math.hypot(*_scale_stds(vehicle_class.sensors)) / math.sqrt(_axles(vehicle_class))


def _scale_stds(sensors: SensorLayout) -> tuple[float, float]:
    least = DAMPING.least_scale_std
    return max(sensors.lateral.scale_std, least), max(sensors.mass_lateral.scale_std, least)


def _axles(vehicle_class: VehicleClass) -> int:
    return 1 if vehicle_class.bogie is None else AXLES_OF_A_BOGIE


def _one(
    vehicle_class: VehicleClass, share: float, stds: Mapping[str, float], step_s: float
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    factors = {name: 1.0 + std for name, std in stds.items() if name != GAIN}
    equations = suspension_equations(vehicle_class, share, factors)
    n = len(equations.rates) + 1
    rates, by_input, measured = np.zeros((n, n)), np.zeros(n), np.ones(n)
    rates[:-1, :-1], by_input[:-1] = equations.rates, equations.by_input
    measured[:-1] = (1.0 + stds.get(GAIN, 0.0)) * equations.measured
    of_wheelsets, above = _densities(vehicle_class.sensors, _axles(vehicle_class))
    intensity = np.outer(by_input, by_input) * of_wheelsets**2 / 2.0
    intensity[-1, -1] = (2.0 * math.pi * DAMPING.offset_corner_hz) ** 2 * above**2 / 2.0
    unit = above**2 / (2.0 * step_s)  # variance of what is measured above, which all covariances are over
    transition, process = over_a_sample(rates, intensity / unit, step_s)
    predicted = scipy.linalg.solve_discrete_are(transition.T, measured[:, None], process, np.eye(1))
    variance = float(measured @ predicted @ measured) + 1.0
    gain = predicted @ measured / variance
    return transition, _held(rates, by_input, step_s), measured, gain


def _held(rates: FloatArray, by_input: FloatArray, step_s: float) -> FloatArray:
    """Return what an input that runs straight from one sample to the next adds, (2, n) by its begin and its end."""
    n = len(rates)
    whole = np.zeros((n + 2, n + 2))
    whole[:n, :n], whole[:n, n], whole[n, n + 1] = step_s * rates, step_s * by_input, 1.0
    made = scipy.linalg.expm(whole)
    return np.stack([made[:n, n] - made[:n, n + 1], made[:n, n + 1]])


def _densities(sensors: SensorLayout, axles: int) -> tuple[float, float]:
    least, share = DAMPING.least_noise_density, math.sqrt(axles)
    return max(sensors.lateral.noise_density, least) / share, max(sensors.mass_lateral.noise_density, least) / share
