"""The conicity of a wheelset on one section, from the merged bin tables of its windows there."""

from __future__ import annotations

import numpy as np

from estimation.geometry.estimate import GeometryParameters, estimate_geometry
from estimation.tables.bin_table import BinParameters
from estimation.values.geometry import BinTable
from estimation.values.intervals import normal_equivalent, parts_of
from estimation.values.quantities import Estimate, Status
from estimation.values.rails import RailKey, SectionConicity, WheelKey
from estimation.values.reasons import Reason


def section_conicity(
    wheel: WheelKey,
    rail: RailKey,
    table: BinTable,
    bins: BinParameters,
    parameters: GeometryParameters,
    *,
    scale_std: float,
    span_ns: tuple[int, int],
) -> SectionConicity | Reason:
    """Return the conicity that windows of a wheelset on one section give, by the estimator of geometries; or why none.

    Args:
        wheel, rail: Wheelset with its mileage interval, section with its period.
        parameters: Of the estimator; their uncertainty is that on this section.
        scale_std: Relative, of a scale of y - d that the alignment of the section leaves open.
        span_ns: Begin of the first and end of the last window, ns UTC.
    """
    found = estimate_geometry(table, bins, parameters)
    if found.status is not Status.ESTIMATED:
        reason = found.reason or found.equivalent_conicity.reason
        assert reason is not None  # whatever is not estimated says why
        return reason
    groups = int((table.weight.sum(axis=1) > 0).sum())
    sampled, systematic = np.array([parts_of(one, groups) for one in found.conicity]).T
    return SectionConicity(
        wheel=wheel,
        rail=rail,
        amplitude=found.amplitude,
        conicity=np.array([_number(one) for one in found.conicity]),
        sampled=normal_equivalent(sampled, groups),
        systematic=systematic,
        scale_std=scale_std,
        windows=table.windows,
        from_ns=span_ns[0],
        to_ns=span_ns[1],
    )


def _number(estimate: Estimate) -> float:
    return float("nan") if estimate.value is None else estimate.value
