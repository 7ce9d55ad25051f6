"""Measured wheelsets, each compared with what the others say of it: profiles may be of another wheelset.

At one amplitude, with the interaction that the cells show by themselves. What the solution says of the wheels of a
wheelset without its own measurements follows from the solution with them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from estimation.rails.component import Component
from estimation.rails.parameters import RailsParameters, ReferenceWheel
from estimation.rails.published import refusal
from estimation.rails.two_way import Parted, part, with_known
from estimation.values.arrays import FloatArray, IntArray
from estimation.values.intervals import with_interval

LARGEST_VARIANCE = 1.0  # of a conicity of which nothing is known


@dataclass(frozen=True, slots=True)
class Check:
    """What the others say of the wheels of a measured wheelset, where it is furthest from that."""

    apart: float  # by how much its conicity as measured is above that
    half: float  # half interval of the difference
    std: float  # of what the others say

    @property
    def ratio(self) -> float:
        """Half intervals between both."""
        return abs(self.apart) / self.half


def checks(component: Component, wheel: ReferenceWheel, parameters: RailsParameters) -> dict[str, Check]:
    """Return by serial how far measured wheelsets are from what the others say; infinite stds where these say nothing.

    Returns:
        dict[str, Check]: None are said to differ at an amplitude at which nothing is published.
    """
    known = np.isfinite(component.two_way.known_value)
    if not known.any():
        return {}
    nothing = np.full(len(known), np.nan)
    alone = part(replace(component.two_way, known_value=nothing), parameters)
    held = with_known(component.two_way, parameters, alone)
    usable = held.converged and refusal(component, alone, wheel, parameters) is None
    serial, shared = component.table.serial[component.wheel], component.shared
    found = {}
    for one in np.unique(serial[known]).tolist():
        own = np.flatnonzero(known & (serial == one))
        checked = _check(component, held, own, shared) if held.converged else _nothing()
        found[component.table.serials[one]] = checked if usable else replace(checked, apart=0.0)
    return found


def _check(component: Component, held: Parted, own: IntArray, shared: float) -> Check:
    """Return how far the wheels of one wheelset are from what the others say of them."""
    left, covariance = _left_out(component, held, own)
    variance = np.diag(covariance)
    if not ((variance > 0.0) & (variance < LARGEST_VARIANCE)).all():
        return _nothing()
    value = component.two_way.known_value
    others = np.isfinite(value)
    others[own] = False
    level = 0.0 if component.two_way.known_rail.any() or not others.any() else float(value[others].mean())
    sampled = np.sqrt(1.0 / held.known_weight[own] + variance)
    systematic = shared * np.abs(value[own] - level)
    groups = 1 + max(1, int(held.freedom))
    intervals = [with_interval(*one, groups) for one in zip(left.tolist(), sampled, systematic, strict=True)]
    half = np.array([(one.high or 0.0) - (one.value or 0.0) for one in intervals])
    worst = int(np.argmax(np.abs(left) / half))
    return Check(float(left[worst]), float(half[worst]), float(np.sqrt(variance.max())))


def _left_out(component: Component, held: Parted, own: IntArray) -> tuple[FloatArray, FloatArray]:
    """Return by how much measured wheels (m,) are above what the others say, and the covariance (m, m) of that."""
    shared, weight = held.shared[own], np.diag(held.known_weight[own])
    with_own = np.diag(1.0 / held.own[own]) + shared @ (shared @ held.covariance).T
    apart = np.eye(len(own)) - with_own @ weight
    residual = component.two_way.known_value[own] - held.wheel[own]
    try:
        return np.linalg.solve(apart, residual), np.linalg.solve(apart, with_own)
    except np.linalg.LinAlgError:  # they alone hold their level
        return residual, np.full_like(apart, np.inf)


def _nothing() -> Check:
    return Check(0.0, np.inf, np.inf)
