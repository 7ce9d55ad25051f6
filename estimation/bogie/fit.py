"""Curves and springs of a bogie from its runs: rounds of simulation, whitening, and instrumental variables."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from estimation.bogie.curves import Curves, nodes
from estimation.bogie.equations import PARAMETERS
from estimation.bogie.parameters import BOGIE
from estimation.bogie.signals import BogieRun
from estimation.bogie.simulation import Gear
from estimation.bogie.sums import UNKNOWNS, Spectra, covariances, normal, spectra
from estimation.values.arrays import FloatArray
from estimation.values.quantities import leave_one_out


@dataclass(frozen=True, slots=True)
class BogieFit:
    """What the runs of a bogie give: the unknowns are the parameters of the equations, then both curves."""

    theta: FloatArray  # (u,)
    without: FloatArray  # (g, u) with each block left out
    by_prior: FloatArray  # (u, u) covariance of what is known beforehand only
    curves: Curves
    gear: Gear
    visited: FloatArray  # (2, b) m run at each node
    likeness: FloatArray  # (2,)
    misfit: float


def priors(stds: FloatArray, b: int, bend: float) -> FloatArray:
    """Return the information (u, u) beforehand on parameters of these stds and on the bends of curves of b nodes."""
    information = np.zeros((UNKNOWNS + 2 * b, UNKNOWNS + 2 * b))
    information[np.arange(UNKNOWNS), np.arange(UNKNOWNS)] = stds**-2.0
    bends = np.diff(np.eye(b), 2, axis=0)
    own = bends.T @ bends / bend**2 + 1e-6 * np.eye(b) / bend**2
    for axle in range(2):
        part = slice(UNKNOWNS + axle * b, UNKNOWNS + (axle + 1) * b)
        information[part, part] = own
    return information


def fit(gear: Gear, stds: FloatArray, runs: Sequence[tuple[int, BogieRun]], rounds: int = BOGIE.rounds, trace=None) -> BogieFit:
    """Return the fit of runs, each with its block."""
    b = len(nodes())
    curves = Curves.straight(BOGIE.start_conicity)
    file_gear = gear
    q = BOGIE.inverse_friction
    gear = replace(gear, inverse_friction=q)
    theta = np.concatenate([np.zeros(UNKNOWNS), curves.values.ravel()])
    friction = PARAMETERS.index("inverse_friction")
    for number in range(rounds):
        parts = [part for block, run in runs if (part := spectra(gear, curves, run, block)) is not None]
        information = priors(stds, b, BOGIE.bend_std if number else BOGIE.first_bend_std)
        expected = np.zeros(len(theta))
        expected[friction] = BOGIE.inverse_friction - gear.inverse_friction
        start = np.array(theta)
        for inner in range(2):
            cov, scales = covariances(parts, start)
            keep = np.arange(len(theta))
            sums = [normal(part, cov, scale, keep) for part, scale in zip(parts, scales, strict=True)]
            block = np.concatenate([part.block for part in parts])
            left = np.concatenate([one for one, _ in sums])
            right = np.concatenate([one for _, one in sums])
            groups = np.unique(block)
            lefts = np.stack([left[block == g].sum(axis=0) for g in groups])
            rights = np.stack([right[block == g].sum(axis=0) for g in groups])
            whole = lefts.sum(axis=0) + information
            found = np.linalg.solve(whole, information @ expected - rights.sum(axis=0))
            start = found
        without = np.stack(
            [
                np.linalg.solve(whole - lefts[g], information @ expected - rights.sum(axis=0) + rights[g])
                for g in range(len(groups))
            ]
        )
        values = found[UNKNOWNS:].reshape(2, b)
        blend = BOGIE.blend if number else 1.0
        values = values - values[:, [b // 2]]
        curves = Curves(curves.values + blend * (values - curves.values))
        more = float(np.clip(gear.inverse_friction + blend * found[friction], 0.0, 8.0))
        inverse = np.linalg.inv(whole)
        visited = sum(part.visited for part in parts)
        likeness = np.mean([part.likeness for part in parts], axis=0)
        p = file_gear.vehicle
        new = replace(
            p,
            yaw_stiffness=p.yaw_stiffness * (1 + 0 * found[0]),
        )
        result = BogieFit(found, without, inverse @ information @ inverse.T, curves, gear, visited, likeness, float(np.mean([s.mean() for s in scales])))
        gear = replace(gear, inverse_friction=more, vehicle=new)
        if trace:
            trace(number, result)
        theta = np.concatenate([found[:UNKNOWNS], curves.values.ravel()])
        theta[friction] = 0.0
    return result
