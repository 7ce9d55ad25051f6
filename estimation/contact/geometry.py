"""Contact geometry of a wheelset on a track: from profiles and dimensions to the contact table."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
import numpy.typing as npt

from estimation.contact import kernels
from estimation.contact.method import ContactMethod
from estimation.contact.parameters import PROFILES
from estimation.contact.profiles import Profile
from estimation.contact.surfaces import Surface, rail_surface, wheel_surface
from estimation.errors import ContactError
from estimation.values.arrays import BoolArray, FloatArray, FrozenArrays, IntArray


@dataclass(frozen=True, slots=True)
class ContactTable(FrozenArrays):
    """Contact geometry of a wheelset on a track; SI, n lateral displacements by g gauge deviations.

    Lateral displacement is that of the axle's middle relative to the track centre, positive to the left; gauge
    deviation is actual minus nominal gauge. For positive displacement the left wheel runs on its larger radius and
    steeper contact angle. Contact angles are those of the wheel's surface against the axle's axis, positive where the
    radius grows towards the flange; against the track plane the left one is larger by the roll, the right one smaller.
    ``contact_position_*`` is the wheel profile's lateral axis (from the tread datum, positive to the field side),
    ``rail_position_*`` the lateral distance from the track centre, positive on both sides. ``exists`` is False where
    there is no contact of both wheels: there the values are those of the nearest displacement that has one.
    ``jump`` marks the grid points with a contact jump between them and a neighbouring displacement: a contact point
    of either side moves by 0.4 mm while the wheelset moves by 4 um or less. Between two such neighbours the values
    must not be interpolated.
    """

    method: ContactMethod
    lateral_displacement: Annotated[FloatArray, "n"]  # m, strictly increasing
    gauge_deviation: Annotated[FloatArray, "g"]  # m, strictly increasing
    roll: Annotated[FloatArray, "n", "g"]  # rad, positive lifts the left wheel; 0 with EN 15302
    rolling_radius_left: Annotated[FloatArray, "n", "g"]  # m
    rolling_radius_right: Annotated[FloatArray, "n", "g"]  # m
    contact_angle_left: Annotated[FloatArray, "n", "g"]  # rad
    contact_angle_right: Annotated[FloatArray, "n", "g"]  # rad
    contact_position_left: Annotated[FloatArray, "n", "g"]  # m
    contact_position_right: Annotated[FloatArray, "n", "g"]  # m
    rail_position_left: Annotated[FloatArray, "n", "g"]  # m
    rail_position_right: Annotated[FloatArray, "n", "g"]  # m
    exists: Annotated[BoolArray, "n", "g"]
    jump: Annotated[BoolArray, "n", "g"]

    @property
    def rolling_radius_difference(self) -> FloatArray:
        """Left minus right rolling radius (n, g), m."""
        return self.rolling_radius_left - self.rolling_radius_right

    @property
    def rolling_radius_sum(self) -> FloatArray:
        """Left plus right rolling radius (n, g), m."""
        return self.rolling_radius_left + self.rolling_radius_right

    @property
    def contact_angle_difference(self) -> FloatArray:
        """Left minus right contact angle (n, g), rad."""
        return self.contact_angle_left - self.contact_angle_right

    @property
    def contact_angle_sum(self) -> FloatArray:
        """Left plus right contact angle (n, g), rad."""
        return self.contact_angle_left + self.contact_angle_right


_REASONS = {
    kernels.NO_OVERLAP: "a wheel is not above its rail",
    kernels.FLANGE_TIP: "a wheel has climbed onto the tip of its flange",
    kernels.OUTER_EDGE: "a wheel rests on its outer edge",
    kernels.NO_ROLL: "no roll brings both wheels onto the rails",
}
_PlainSurface = tuple[float, float, FloatArray, FloatArray]
_Sides = tuple[_PlainSurface, _PlainSurface]
Setting = tuple[bool, float, tuple[float, float], _Sides, _Sides]
"""Whether the wheelset rolls, half the distance of the tread datums, the radii, wheels and rails, for the kernels."""


@dataclass(frozen=True, slots=True)
class WheelsetOnTrack:
    """A wheelset and the track under it, as far as contact geometry goes; SI."""

    left_wheel: Profile
    right_wheel: Profile
    left_rail: Profile
    right_rail: Profile
    inclination: float  # tangent; 0 for rails given in track axes
    gauge: float  # m, nominal, measured within 14 mm below the top of the rails
    left_radius: float = PROFILES.usual_radius  # m, at the tread datum
    right_radius: float = PROFILES.usual_radius
    flange_back_distance: float = PROFILES.flange_back_distance  # m

    def __post_init__(self) -> None:
        for field in ("left_wheel", "right_wheel", "left_rail", "right_rail"):
            kind = field.partition("_")[2]
            if getattr(self, field).kind != kind:
                raise ContactError(f"{getattr(self, field).name!r} is no {kind}", field=field)
        for field in ("gauge", "left_radius", "right_radius", "flange_back_distance"):
            value = getattr(self, field)
            if not (math.isfinite(value) and value > 0.0):
                raise ContactError(f"{value!r} is not a positive length", field=field)
        if not abs(self.inclination) < 1.0:
            raise ContactError(f"{self.inclination!r} is no inclination (its tangent, as 1/20)", field="inclination")

    @staticmethod
    def symmetric(
        wheel: Profile, rail: Profile, inclination: float, gauge: float, *, radius: float = PROFILES.usual_radius
    ) -> WheelsetOnTrack:
        """Return the wheelset with the same wheel, rail and radius on both sides."""
        return WheelsetOnTrack(wheel, wheel, rail, rail, inclination, gauge, radius, radius)


def contact_table(
    wheelset: WheelsetOnTrack,
    lateral_displacement: npt.ArrayLike,
    gauge_deviation: npt.ArrayLike = (0.0,),
    *,
    method: ContactMethod = ContactMethod.RIGID,
    outside: Literal["raise", "hold"] = "raise",
) -> ContactTable:
    """Return the contact geometry at every lateral displacement and gauge deviation.

    Args:
        lateral_displacement: (n,) m, strictly increasing: of the axle's middle, positive to the left.
        gauge_deviation: (g,) m, strictly increasing: actual minus nominal gauge.
        method: ``RIGID``: the wheelset rolls about the axle's middle until both wheels touch. ``EN15302``: it does not
            roll, and each wheel touches where its vertical gap is smallest, as the reference results are made.
        outside: What to do where there is no contact (a wheel on the tip of its flange, or off the rail): ``raise``,
            or ``hold`` the values of the nearest displacement that has contact, marked in ``exists``.

    Raises:
        ContactError: A grid that is not finite and increasing; profiles that never touch; no contact somewhere.
    """
    displacement, deviation, setting, values, outcomes = search_contacts(
        wheelset, lateral_displacement, gauge_deviation, method=method, outside=outside
    )
    exists = outcomes == kernels.FOUND
    crossed = kernels.jumps(displacement, deviation, values, outcomes, *setting)
    roll, left, right, rail_left, rail_right = _held(values, exists)
    return ContactTable(
        method=method,
        lateral_displacement=displacement,
        gauge_deviation=deviation,
        roll=roll,
        rolling_radius_left=wheelset.left_radius + wheelset.left_wheel.height(left),
        rolling_radius_right=wheelset.right_radius + wheelset.right_wheel.height(right),
        contact_angle_left=-np.arctan(wheelset.left_wheel.gradient(left)),
        contact_angle_right=-np.arctan(wheelset.right_wheel.gradient(right)),
        contact_position_left=left,
        contact_position_right=right,
        rail_position_left=rail_left,
        rail_position_right=rail_right,
        exists=exists,
        jump=np.pad(crossed, ((0, 1), (0, 0))) | np.pad(crossed, ((1, 0), (0, 0))),
    )


def search_contacts(
    wheelset: WheelsetOnTrack,
    lateral_displacement: npt.ArrayLike,
    gauge_deviation: npt.ArrayLike,
    *,
    method: ContactMethod,
    outside: Literal["raise", "hold"],
) -> tuple[FloatArray, FloatArray, Setting, FloatArray, IntArray]:
    """Return displacements (n,), deviations (g,), the kernels' setting, values (5, n, g) and outcomes (n, g).

    They are those of ``kernels.table``; what is raised is as :func:`contact_table` raises it.
    """
    displacement = _grid(lateral_displacement, "lateral_displacement")
    deviation = _grid(gauge_deviation, "gauge_deviation")
    setting = search_setting(wheelset, method)
    values, outcomes = kernels.table(displacement, deviation, *setting)
    if not (outcomes == kernels.FOUND).all():
        _check_outcomes(displacement, deviation, outcomes, outside)
    return displacement, deviation, setting, values, outcomes


def search_setting(wheelset: WheelsetOnTrack, method: ContactMethod) -> Setting:
    """Return what the compiled search takes of a wheelset beside displacement and gauge."""
    wheels = (_plain(wheel_surface(wheelset.left_wheel)), _plain(wheel_surface(wheelset.right_wheel)))
    left_rail = _plain(rail_surface(wheelset.left_rail, wheelset.inclination, wheelset.gauge))
    right_rail = _plain(rail_surface(wheelset.right_rail, wheelset.inclination, wheelset.gauge))
    half = wheelset.flange_back_distance / 2.0 + PROFILES.tread_datum
    radii = (wheelset.left_radius, wheelset.right_radius)
    return method is ContactMethod.RIGID, half, radii, wheels, (left_rail, right_rail)


def _plain(surface: Surface) -> _PlainSurface:
    return surface.start, surface.step, surface.height, surface.slope


def _grid(values: npt.ArrayLike, field: str) -> FloatArray:
    grid = np.array(values, dtype=np.float64, ndmin=1)
    if grid.ndim != 1 or len(grid) == 0 or not np.isfinite(grid).all():
        raise ContactError("must be a list of finite numbers", field=field)
    if (np.diff(grid) <= 0).any():
        raise ContactError("must increase strictly", field=field)
    return grid


def _check_outcomes(displacement: FloatArray, deviation: FloatArray, outcomes: IntArray, outside: str) -> None:
    missing = outcomes != kernels.FOUND
    if missing.all():
        raise ContactError(f"the profiles never touch: {_REASONS[int(outcomes[len(displacement) // 2, 0])]}")
    if outside == "hold" and not missing.all(axis=0).any():
        return
    order = np.argsort(np.abs(displacement), kind="stable")
    row, column = next((int(i), int(j)) for i in order for j in np.flatnonzero(missing[i]))
    raise ContactError(
        f"no contact at lateral displacement {displacement[row] * 1e3:+.3f} mm, gauge deviation "
        f"{deviation[column] * 1e3:+.3f} mm: {_REASONS[int(outcomes[row, column])]}",
        field="lateral_displacement",
    )


def _held(values: FloatArray, exists: BoolArray) -> FloatArray:
    """Return ``values`` (k, n, g) with every gap filled by the nearest row of its column that exists."""
    if exists.all():
        return values
    held = values.copy()
    for column in range(exists.shape[1]):
        rows = np.flatnonzero(exists[:, column])
        wanted = np.arange(exists.shape[0])
        nearest = rows[np.abs(wanted[:, np.newaxis] - rows[np.newaxis, :]).argmin(axis=1)]
        held[:, :, column] = values[:, nearest, column]
    return held


_HOLD = PROFILES.jump_neighbours * kernels.CURVE_INTERVAL  # m, neighbours on both sides of a jump are no farther apart


@dataclass(frozen=True, slots=True)
class RadiusDifferenceCurve(FrozenArrays):
    """Left minus right rolling radius, straight between points that were set as densely as that takes; SI.

    A contact jump is between two points less than 2 nm apart. Displacements without contact have no points.
    """

    displacement: Annotated[FloatArray, "n"]  # m, strictly increasing
    difference: Annotated[FloatArray, "n"]  # m
    jumps: Annotated[FloatArray, "k"]  # m, displacements at which a contact point of either side jumps


def radius_difference_curve(
    wheelset: WheelsetOnTrack,
    lateral_displacement: npt.ArrayLike,
    gauge_deviation: float = 0.0,
    *,
    method: ContactMethod = ContactMethod.EN15302,
) -> RadiusDifferenceCurve:
    """Return the rolling radius difference, refined between the points of a grid.

    Each cell is halved until the curve is straight in it to 0.2 um; a jump is placed by bisection of the contact
    search to 1 nm. So integrals over the curve (EN 15302) do not depend on the grid. Arguments are as those of
    :func:`contact_table`.
    """
    grid, _, setting, values, outcomes = search_contacts(
        wheelset, lateral_displacement, (gauge_deviation,), method=method, outside="hold"
    )
    return _refined(wheelset, grid, gauge_deviation, values[:, :, 0], outcomes[:, 0], setting)


def refined_curve(wheelset: WheelsetOnTrack, table: ContactTable, column: int) -> RadiusDifferenceCurve:
    """Return the same curve from a contact table that has been searched already, at one of its gauges (``column``)."""
    positions = (table.contact_position_left, table.contact_position_right)
    contacts = (table.roll, *positions, table.rail_position_left, table.rail_position_right)
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
    displacement, (left, right) = kernels.refined(grid, gauge_deviation, values, outcomes, *setting)
    radius_left = wheelset.left_radius + wheelset.left_wheel.height(left)
    radius_right = wheelset.right_radius + wheelset.right_wheel.height(right)
    moved = np.maximum(np.abs(np.diff(left)), np.abs(np.diff(right)))
    jumped = np.flatnonzero((moved > kernels.JUMP_DISTANCE) & (np.diff(displacement) < _HOLD))
    jumps = 0.5 * (displacement[jumped] + displacement[jumped + 1])
    return RadiusDifferenceCurve(displacement, radius_left - radius_right, jumps)
