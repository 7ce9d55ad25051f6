"""The paper's two simulations, and what the two estimators make of them.

One wheelset with a worn P8 profile on a new 113A rail (56E1), Table A.1 at 20 m/s, ideal sensors, alignment of 2 mm
standard deviation; first at constant gauge, then with a gauge variation of 2 mm standard deviation. The alignment is
known to the estimators, the gauge is not.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from estimation.contact.geometry import ContactTable, WheelsetOnTrack, contact_table
from estimation.contact.profiles import rail_profile, wheel_profile
from estimation.contact.wear import WearFamily, wear_course, worn
from estimation.estimators import paper_equations
from estimation.geometry.estimate import GeometryParameters, estimate_geometry
from estimation.geometry.uncertainty import ParameterUncertainty
from estimation.tables import bin_table
from estimation.values.arrays import FloatArray
from estimation.values.geometry import COMBINATIONS, WheelsetGeometry
from estimation.values.windows import Motion
from estimation.vehicle.equations_of_motion import VehicleParameters
from ingest.simulator.motion import STEP, WheelsetMotion, simulate_wheelset
from ingest.simulator.track import TrackRecipe, make_track

SPEED = 20.0  # m/s, Table A.1
STANDARD_DEVIATION = 2.0e-3  # m, of alignment and of gauge
WEAR_DEPTH = 1.0e-3  # m of tread, the medium state after 117,000 miles
GAUGE = 1.435  # m
INCLINATION = 1 / 20
BLOCK_S = 20.0
REACH = 8.0e-3  # m of lateral displacement in the contact table
GAUGE_REACH = 8.0e-3  # m


@dataclass(frozen=True, slots=True)
class Case:
    """One simulation with both estimates of it; truth (b,) by combination at the bins of ``estimate``."""

    gauge_std: float
    table: ContactTable
    motion: WheelsetMotion
    estimate: WheelsetGeometry
    printed: paper_equations.PaperGeometry
    truth: dict[str, FloatArray]  # at the bin centres, nominal gauge
    jump: FloatArray  # (b,) largest step of rL - rR inside the bin at nominal gauge, m


def contact(gauge_deviation: FloatArray) -> ContactTable:
    """Return the contact geometry of the worn wheelset, rigid with roll."""
    wheel = worn(wheel_profile("P8"), wear_course(WearFamily.P8_ON_56E1, WEAR_DEPTH))
    wheelset = WheelsetOnTrack.symmetric(wheel, rail_profile("56E1"), INCLINATION, GAUGE)
    displacement = np.linspace(-REACH, REACH, 641)
    return contact_table(wheelset, displacement, gauge_deviation, outside="hold")


def run(gauge_std: float, seconds: float, seed: int) -> Case:
    """Simulate and estimate one case; the std of the gauge, m, is zero in the paper's first simulation."""
    gauge_grid = np.linspace(-GAUGE_REACH, GAUGE_REACH, 33) if gauge_std else np.zeros(1)
    table = contact(gauge_grid)
    length = SPEED * seconds + 100.0
    recipe = TrackRecipe(length=length, alignment_std=STANDARD_DEVIATION, gauge_std=gauge_std)
    track = make_track(recipe, np.random.SeedSequence(seed))
    speed = np.full(round(seconds / STEP), SPEED)
    motion = simulate_wheelset(VehicleParameters(), table, track, speed, 20.0)
    seen = ideal_motion(motion)
    parameters = bin_table.BinParameters()
    certain = GeometryParameters(uncertainty=ParameterUncertainty(0.0, 0.0, 0.0, inverse_friction=0.0))
    estimate = estimate_geometry(bin_table.tabulate(seen, parameters), parameters, certain)
    printed = paper_equations.estimate(seen, paper_equations.PaperParameters(width=parameters.width))
    truth, jump = _truth(table, estimate.bin_edges)
    return Case(gauge_std, table, motion, estimate, printed, truth, jump)


def ideal_motion(motion: WheelsetMotion) -> Motion:
    """Return what ideal sensors and a known alignment make of a wheelset's motion, after the first two seconds."""
    return Motion(
        speed=motion.speed,
        displacement=motion.relative_displacement,
        lateral_velocity=motion.lateral_velocity,
        lateral_acceleration=motion.lateral_acceleration,
        yaw=motion.yaw,
        yaw_rate=motion.yaw_rate,
        yaw_acceleration=motion.yaw_acceleration,
        roll=motion.roll,
        roll_rate=motion.roll_rate,
        suspension_deflection=motion.mass_lateral_displacement - motion.lateral_displacement,
        suspension_deflection_rate=motion.mass_lateral_velocity - motion.lateral_velocity,
        valid=motion.t > 2.0,  # noqa: PLR2004 - the start from rest is over
        block=np.floor(motion.t / BLOCK_S).astype(np.int64),
        band_limited=False,
    )


def _truth(table: ContactTable, edges: FloatArray) -> tuple[dict[str, FloatArray], FloatArray]:
    nominal = int(np.argmin(np.abs(table.gauge_deviation)))
    x = table.lateral_displacement
    centre = 0.5 * (edges[:-1] + edges[1:])
    truth = {name: np.interp(centre, x, getattr(table, name)[:, nominal]) for name in COMBINATIONS}
    step = np.where(
        table.jump[:-1, nominal] & table.jump[1:, nominal],
        np.abs(np.diff(table.rolling_radius_difference[:, nominal])),
        0,
    )
    at = 0.5 * (x[:-1] + x[1:])
    jump = np.array([step[(at >= a) & (at < b)].max(initial=0.0) for a, b in pairwise(edges)])
    return truth, jump
