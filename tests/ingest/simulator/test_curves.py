"""Curves, cant and stops of the simulated track against what statics says of them, and layouts from files."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from analytic_contact import cones

from estimation.errors import InputError
from estimation.values.arrays import FloatArray
from estimation.vehicle.vehicle_class import VehicleParameters
from ingest.simulator.motion import WheelsetMotion
from ingest.simulator.running_gear import RunningGear, simulate_gear
from ingest.simulator.sensors import ideal_node, measure
from ingest.simulator.track import Curve, TrackRecipe, TrackTruth, make_track, read_track, write_track
from ingest.track_file import read_layout_columns

P = VehicleParameters()
CURVE = Curve(start=100.0, length=900.0, radius=1500.0, cant=0.08, transition=80.0)
SPEED = 20.0
HEADER = "s_m,curvature_per_km,cant_mm"


def track(curve: Curve, alignment_std: float = 0.0) -> TrackTruth:
    recipe = TrackRecipe(length=1200.0, alignment_std=alignment_std, curves=(curve,))
    return make_track(recipe, np.random.SeedSequence(1))


def run(curve: Curve, speed: float = SPEED, conicity: float = 0.2) -> WheelsetMotion:
    return simulate_gear(
        RunningGear(P), [cones(conicity)], track(curve), np.full(round(1000 * 1100 / speed), speed), 10.0
    )[0]


def middle(motion: WheelsetMotion, values: FloatArray) -> float:
    inside = (motion.distance > 700.0) & (motion.distance < 900.0)
    return float(np.asarray(values)[inside].mean())


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_in_a_steady_curve_the_radius_difference_balances_path_and_yaw_spring(side: float) -> None:
    curve = replace(CURVE, radius=side * CURVE.radius, cant=side * CURVE.cant)
    motion = run(curve)
    difference = middle(motion, motion.rolling_radius_left - motion.rolling_radius_right)
    uncompensated = SPEED**2 / curve.radius - 9.81 * curve.cant / (2 * P.half_contact_distance)
    yaw = (P.wheelset_mass + P.suspended_mass) * uncompensated / (2 * P.lateral_creep_coefficient)
    path = -2 * P.half_contact_distance * P.nominal_radius / curve.radius
    arm = P.half_contact_distance * P.longitudinal_creep_coefficient / P.nominal_radius
    assert difference == pytest.approx(path - P.yaw_stiffness * yaw / arm, rel=0.01)
    assert np.sign(middle(motion, motion.relative_displacement)) == -side  # outwards
    stretch = middle(motion, motion.mass_lateral_displacement - motion.lateral_displacement)
    assert stretch == pytest.approx(-P.suspended_mass * uncompensated / P.lateral_stiffness, rel=0.01)


def test_sensors_feel_the_uncompensated_acceleration_and_the_turn() -> None:
    motion = run(CURVE)
    record = measure(motion, ideal_node(), np.random.default_rng(0), np.zeros(4))
    uncompensated = SPEED**2 / CURVE.radius - 9.81 * CURVE.cant / (2 * P.half_contact_distance)
    for place in (0, 3):
        assert middle(motion, record.values[:, place]) == pytest.approx(uncompensated, rel=1e-3)
    before = motion.distance < 500.0
    turned = record.values[before, 1].sum() * 1e-3
    assert turned == pytest.approx(SPEED / CURVE.radius, rel=1e-3)
    tilted = np.cumsum(np.cumsum(record.values[before, 2])) * 1e-6
    rolled = tilted[-1] - (motion.roll[before][-1] - motion.roll[0])
    assert rolled == pytest.approx(-CURVE.cant / (2 * P.half_contact_distance), rel=1e-2)  # the left wheel is down


def test_at_the_balancing_cant_the_mass_feels_nothing() -> None:
    cant = 2 * P.half_contact_distance * SPEED**2 / CURVE.radius / 9.81
    motion = run(replace(CURVE, cant=cant))
    stretch = motion.mass_lateral_displacement - motion.lateral_displacement
    assert abs(middle(motion, stretch)) < 1e-6


def test_a_wheelset_that_stops_stands_and_runs_on() -> None:
    t = np.arange(60_000) * 1e-3
    speed = np.interp(t, [0, 20, 30, 50, 60], [10.0, 0.0, 0.0, 10.0, 10.0])
    rough = make_track(TrackRecipe(length=400.0), np.random.SeedSequence(2))
    motion = simulate_gear(RunningGear(P), [cones(0.2)], rough, speed, 10.0)[0]
    standing = (t > 20.1) & (t < 30.0)
    assert np.ptp(motion.lateral_displacement[standing]) == 0.0
    assert not motion.yaw_rate[standing].any()
    assert np.ptp(motion.mass_lateral_displacement[standing][-1000:]) < 1e-6
    assert np.isfinite(motion.lateral_acceleration).all()
    assert np.abs(motion.relative_displacement).max() < 8e-3
    assert motion.outside == 0
    running = motion.distance[-1] - motion.distance[0]
    assert running == pytest.approx(300.0, rel=1e-3)


def test_a_straight_track_and_a_curve_of_no_curvature_give_the_same_bits() -> None:
    flat = Curve(100.0, 500.0, radius=np.inf, cant=0.0, transition=50.0)
    plain = make_track(TrackRecipe(length=1200.0), np.random.SeedSequence(1))
    curved = replace(track(flat, 2e-3), alignment=plain.alignment)
    first, second = (
        simulate_gear(RunningGear(P), [cones(0.2)], item, np.full(5000, 20.0), 10.0)[0] for item in (plain, curved)
    )
    np.testing.assert_array_equal(first.lateral_acceleration, second.lateral_acceleration)


def test_curves_survive_a_file(tmp_path: Path) -> None:
    written = track(CURVE, 2e-3)
    write_track(tmp_path / "t.csv", written)
    read = read_track(tmp_path / "t.csv")
    assert written.curves is not None
    assert read.curves is not None
    np.testing.assert_allclose(read.curves.curvature, written.curves.curvature, atol=1e-9)
    np.testing.assert_allclose(read.curves.cant, written.curves.cant, atol=1e-9)
    assert written.curves.curvature.max() == pytest.approx(1 / CURVE.radius)


@pytest.mark.parametrize(
    ("header", "rows", "field", "reason"),
    [
        ("s_m,curvature_per_km", ["0,0", "9,1"], "cant_mm", "no such column"),
        ("s_m,curvature,cant_mm", ["0,0,0", "9,1,0"], "curvature", "expected curvature_per_km"),
        ("s_m,radius_m,cant_mm", ["0,800,0", "9,800,0"], "radius_m", "expected curvature_per_km"),
        ("s_m,curvature_per_km,cant_m", ["0,0,0", "9,1,0.1"], "cant_m", "expected curvature_per_km"),
        (HEADER, ["0,0,0", "9,800,100"], "curvature_per_km", "are these radii"),
        (HEADER, ["0,0,0", "9,1.2,0.1"], "cant_mm", "cant in metres"),
        (HEADER, ["0,0,0", "9,0.0012,100"], "curvature_per_km", "curvature in 1/m"),
        (HEADER, ["0,0,0", "9,1.2,400"], "cant_mm", "on no line"),
        (HEADER, ["0,0,0"], None, "1 rows"),
        (HEADER, ["0,0,0", "9,1.2"], "cant_mm", "not a finite number"),
        (HEADER, ["5,0,0", "5,1.2,10"], "s_m", "does not increase"),
    ],
)
def test_bad_layouts_are_refused_with_their_place(
    tmp_path: Path, header: str, rows: list[str], field: str | None, reason: str
) -> None:
    path = tmp_path / "layout.csv"
    path.write_text("\n".join([header, *rows]))
    with pytest.raises(InputError, match=reason) as refused:
        read_layout_columns(path)
    assert (refused.value.file, refused.value.field) == (str(path), field)


def test_a_file_without_layout_has_none(tmp_path: Path) -> None:
    path = tmp_path / "plain.csv"
    path.write_text("s_m,alignment_mm,gauge_deviation_mm\n0,0,0\n1,0,0\n")
    assert read_layout_columns(path) is None
