"""The rolling radius difference over the lateral displacement, with every contact jump where it is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from estimation.contact import kernels
from estimation.contact.geometry import (
    ContactMethod,
    ContactTable,
    Setting,
    WheelsetOnTrack,
    search_contacts,
    search_setting,
)
from estimation.values.arrays import FloatArray, IntArray, freeze, frozen_array

_HOLD = 1.5 * kernels.CURVE_INTERVAL  # m, neighbours on both sides of a jump are no farther apart


@dataclass(frozen=True, slots=True)
class RadiusDifferenceCurve:
    """Left minus right rolling radius, straight between points that were set as densely as that takes; SI.

    A contact jump is between two points less than 2 nm apart. Displacements without contact have no points.
    """

    displacement: FloatArray  # (n,) m, strictly increasing
    difference: FloatArray  # (n,) m
    jumps: FloatArray  # (k,) m, displacements at which a contact point of either side jumps

    def __post_init__(self) -> None:
        freeze(self)
        for name, n in (("displacement", None), ("difference", len(self.displacement)), ("jumps", None)):
            object.__setattr__(self, name, frozen_array(getattr(self, name), (n,), name=name))


def radius_difference_curve(
    wheelset: WheelsetOnTrack,
    lateral_displacement: npt.ArrayLike,
    gauge_deviation: float = 0.0,
    *,
    method: ContactMethod = ContactMethod.EN15302,
) -> RadiusDifferenceCurve:
    """Return the rolling radius difference, refined between the points of a grid.

    Each cell is halved until the curve is straight in it to 0.2 um; a jump is placed by bisection of the contact
    search to 1 nm. So integrals over the curve (EN 15302) do not depend on the grid.

    Args:
        lateral_displacement: (n,) m, strictly increasing: of the axle's middle relative to the track centre, positive
            to the left.
        gauge_deviation: Actual minus nominal gauge, m.
        method: How contact points are found, as :func:`estimation.contact.geometry.contact_table` takes it.

    Raises:
        ContactError: A grid that is not finite and increasing; profiles that never touch.
    """
    grid, _, setting, values, outcomes = search_contacts(
        wheelset, lateral_displacement, (gauge_deviation,), method=method, outside="hold"
    )
    return _refined(wheelset, grid, gauge_deviation, values[:, :, 0], outcomes[:, 0], setting)


def refined_curve(wheelset: WheelsetOnTrack, table: ContactTable, column: int) -> RadiusDifferenceCurve:
    """Return the same curve from a contact table that has been searched already, at one of its gauges.

    Args:
        table: As :func:`estimation.contact.geometry.contact_table` returns it.
        column: Of ``table.gauge_deviation``, from 0.
    """
    contacts = (
        table.roll,
        table.contact_position_left,
        table.contact_position_right,
        table.rail_position_left,
        table.rail_position_right,
    )
    values = np.array([values[:, column] for values in contacts])
    outcomes = np.where(table.exists[:, column], kernels.FOUND, kernels.NO_ROLL)
    grid = np.array(table.lateral_displacement)  # writable, as the kernel is compiled for
    gauge_deviation = float(table.gauge_deviation[column])
    setting = search_setting(wheelset, table.method)
    return _refined(wheelset, grid, gauge_deviation, values, outcomes, setting)


def _refined(
    wheelset: WheelsetOnTrack,
    grid: FloatArray,
    gauge_deviation: float,
    values: FloatArray,
    outcomes: IntArray,
    setting: Setting,
) -> RadiusDifferenceCurve:
    """Return the curve from contacts on the wheels and rails (5, n) on ``grid`` (n,), and their outcomes (n,)."""
    displacement, (left, right) = kernels.refined(grid, gauge_deviation, values, outcomes, *setting)
    radius_left = wheelset.left_radius + wheelset.left_wheel.height(left)
    radius_right = wheelset.right_radius + wheelset.right_wheel.height(right)
    moved = np.maximum(np.abs(np.diff(left)), np.abs(np.diff(right)))
    jumped = np.flatnonzero((moved > kernels.JUMP_DISTANCE) & (np.diff(displacement) < _HOLD))
    jumps = 0.5 * (displacement[jumped] + displacement[jumped + 1])
    return RadiusDifferenceCurve(displacement, radius_left - radius_right, jumps)
