"""What the fit of a bogie says of the rolling radius difference of one wheelset, as the geometry publishes it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from estimation.bogie.equations import PARAMETERS
from estimation.bogie.fit import BogieFit
from estimation.bogie.parameters import BOGIE
from estimation.geometry.conicity import CurveReplicates
from estimation.geometry.uncertainty import DisplacementError, ParameterUncertainty
from estimation.values.arrays import FloatArray, bin_centres
from estimation.values.error_parts import ErrorSource
from estimation.values.geometry import Contradiction
from estimation.values.reasons import Reason, ReasonCode

_BY_NAME = {
    "stiffness": ErrorSource.STIFFNESS,
    "friction": ErrorSource.FRICTION,
    "creep": ErrorSource.CREEP,
    "inertia": ErrorSource.INERTIA,
    "shift": ErrorSource.ALIGNMENT,
    "_": ErrorSource.SENSORS,
}

SOURCES = tuple(
    next(source for part, source in _BY_NAME.items() if part in name) for name in PARAMETERS
)  # of the error by each parameter


def curve_replicates(
    fit: BogieFit,
    axle: int,
    edges: FloatArray,
    uncertainty: ParameterUncertainty,
    sensors_std: float,
    count: float,
) -> CurveReplicates:
    """Return R of an axle, 0 or 1, over bins that are centred on the nodes.

    Args:
        sensors_std: Of y - d by sensors, m.
        count: Windows.
    """
    own, visited = fit.curve(axle), fit.visited[axle]
    # what is slow has no mean: R is counted from its mean over the run
    centred = np.eye(len(visited)) - visited / visited.sum()
    curves = fit.replicates[:, own] @ centred.T
    values, vectors = np.linalg.eigh(centred @ fit.by_bends[own, own] @ centred.T)
    seen = values > BOGIE.least_bend_share * values[-1]
    of_bends = (vectors[:, seen] * np.sqrt(values[seen])).T
    of_parameters = np.vstack([fit.by_parameter, fit.by_law])[:, own] @ centred.T
    # what the instruments have in common with y - d flattens the curve; the noise of the sensors does not
    shared = float(np.hypot(uncertainty.alignment_noise, fit.open_std[axle]))
    centre, scale = bin_centres(edges), uncertainty.displacement
    of_shared = DisplacementError.of(shared, centre, visited, integrated=True, scale=scale)
    error = replace(
        of_shared,
        std=float(np.hypot(shared, sensors_std)),
        jump_position_std=uncertainty.jump_position_std,
        jump_mean_std=uncertainty.jump_mean_std,
        gauge_known=uncertainty.gauge_known,
    )
    shapes = in_bins(np.concatenate([of_parameters, of_bends, uncertainty.scale * curves[:1]]))
    return CurveReplicates(
        edges=edges,
        difference=in_bins(curves),
        sensitivity=np.moveaxis(shapes, 0, 1),
        usable=visited >= BOGIE.least_visited,
        error=error,
        count=count,
        band_limited=True,
        held_shares=uncertainty.held_shares,
        contact_roll=uncertainty.contact_roll,
        sources=(*SOURCES, ErrorSource.FRICTION, *[ErrorSource.BLUR] * len(of_bends), ErrorSource.SCALE),
    )


def spring_differs(fit: BogieFit, class_std: float) -> Contradiction | None:
    """Return that the springs of a bogie, over its creep, are not those of its class; None where they may be.

    Args:
        class_std: Relative std of the yaw stiffness over the creep coefficient on file.
    """
    ratio, std = fit.stiffness_ratio
    both = float(np.hypot(std, class_std))
    if abs(ratio - 1.0) <= BOGIE.doubted_spring_stds * both:
        return None
    text = (
        f"yaw stiffness over creep coefficient is {ratio:.2f} of that of the vehicle's class (std {both:.2f});"
        " check the class, or put the std of its creep on file: dirty rails have half the creep of clean ones"
    )
    certain = abs(ratio - 1.0) > BOGIE.certain_spring_stds * both
    reason = Reason(ReasonCode.YAW_SPRING_DIFFERS, text)
    return Contradiction(reason, certain, BOGIE.spring_share * abs(ratio - 1.0))


def in_bins(curves: FloatArray) -> FloatArray:
    """Return curves (r, b), straight between the centres of bins, as value, slope, curvature in each (r, b, 3)."""
    padded = np.concatenate([2 * curves[:, :1] - curves[:, 1:2], curves, 2 * curves[:, -1:] - curves[:, -2:-1]], axis=1)
    before, here, behind = padded[:, :-2], curves, padded[:, 2:]
    return np.stack([here, 0.5 * (behind - before), before - 2.0 * here + behind], axis=2)
