"""The conicity of a wheelset in motion against that of EN 15302, by pair of profiles; no sensor has noise.

Each wheelset runs at 20 m/s along an alignment of 2 mm std by the equations of motion, rigid with roll, and its motion
is estimated three times: on track of which the sensors show that it is level, on track that may roll, and by the
displacement of the axle as it is. The truth is contact without roll at nominal gauge. Behind the first two are the half
widths of their intervals by what is left open of the displacement.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path

import numpy as np

from api.reproduction import ideal_motion
from bench.report import Bench, BenchRow, Part, ResultTable, printed, row_table
from bench.scores import Cluster, Compared, figures_table
from bench.worn_family import PAIRS, USUAL_CONICITY, wheelsets
from estimation.contact.conicity import equivalent_conicity
from estimation.contact.geometry import WheelsetOnTrack, contact_table, radius_difference_curve, refined_curve
from estimation.contact.profiles import Profile, rail_profile, wheel_profile
from estimation.contact.wear import TreadWear, WearFamily, wear_course, worn
from estimation.errors import ContactError
from estimation.geometry.conicity import CurveParameters, CurveReplicates, curve_estimates
from estimation.geometry.estimate import GeometryParameters, estimate_geometry
from estimation.geometry.sharpening import SLOPES, ContactRoll, held_shares, left_in_difference
from estimation.geometry.uncertainty import SCALE_STDS, DisplacementError, ParameterUncertainty
from estimation.motion.integration import standard_displacement
from estimation.tables import bin_table
from estimation.tables.bin_table import BinParameters
from estimation.values.arrays import FloatArray
from estimation.vehicle.vehicle_class import VehicleClass, VehicleParameters
from ingest.simulator.motion import STEP, WheelsetMotion
from ingest.simulator.running_gear import RunningGear, simulate_gear
from ingest.simulator.track import TrackRecipe, make_track
from ingest.vehicle_class_schema import shipped_class

FAMILY_AMPLITUDES = (2.0e-3, 2.5e-3, 3.0e-3)
FAMILY_GRID = 0.01e-3 * np.arange(-700, 701)  # m
FAMILY_REACH = 3.7e-3  # m, of the bins
EVERY = 4  # wheelset of a pair
GROUPS = 4
IN_BIN = 25  # places
COVERED = 0.92  # share that the 95 % intervals are to hold
NAMES = {ContactRoll.SEEN: "level track", ContactRoll.HIDDEN: "track that may roll"}


Family = Mapping[ContactRoll, FloatArray]
"""Errors and half widths (w, 2, 3, 2) of worn wheelsets: without and with what R says, amplitude, which of both."""


def family() -> Family:
    """Return the errors on level track and on track that may roll."""
    of_all = list(_wheelsets())
    found = {roll: [_family_errors(wheelset, roll) for wheelset in of_all] for roll in ContactRoll}
    return {roll: np.array([one for one in errors if one is not None]) for roll, errors in found.items()}


def family_figures(errors: Family) -> ResultTable:
    """Return the figures of worn wheelsets with what R says, by amplitude; each is a cluster."""
    groups = [
        (f"{NAMES[roll]}, {1e3 * amplitude:g} mm", [_number(*one) for one in of_roll[:, 1, place]])
        for roll, of_roll in errors.items()
        for place, amplitude in enumerate(FAMILY_AMPLITUDES)
    ]
    return figures_table("Worn wheelsets of pairs not used for constants", groups)


def _number(error: float, half_width: float) -> Cluster:
    return Cluster([Compared(float(error), float(half_width), bool(abs(error) <= half_width))])


def _wheelsets() -> Iterator[WheelsetOnTrack]:
    for pair in PAIRS[1::2]:
        for (left, right), rail in islice(wheelsets(pair), 0, None, EVERY):
            yield WheelsetOnTrack(left, right, rail, rail, 1.0 / pair.inclination, 1.435)


def _family_row(roll: ContactRoll, error: FloatArray) -> BenchRow:
    rms = np.sqrt(np.mean(error[..., 0] ** 2, axis=0))
    inside = np.mean(np.abs(error[..., 0]) <= error[..., 1], axis=0)
    width = np.median(error[..., 1], axis=0)
    said = "; ".join(
        f"{name} rms of the error {_text(rms[k])}, half width {_text(width[k])} (median), holds"
        f" {_percents(inside[k])} %"
        for k, name in enumerate(("without what R says", "with it"))
    )
    return BenchRow(
        f"{len(error)} worn wheelsets of pairs not used for constants, {NAMES[roll]}, 2 / 2.5 / 3 mm",
        said,
        "smaller error; intervals hold 92 %",
        bool((rms[1] < rms[0]).all() and (inside[1] >= COVERED).all()),
    )


def _family_errors(wheelset: WheelsetOnTrack, roll: ContactRoll) -> FloatArray | None:
    """Return (2, 3, 2) without and with what R says, by amplitude, error and half width; None for no usual wheelset."""
    try:
        table, standard = (
            contact_table(wheelset, FAMILY_GRID, outside="hold"),
            radius_difference_curve(wheelset, FAMILY_GRID[::10]),
        )
        ran = refined_curve(wheelset, table, 0)
    except ContactError:
        return None
    true = equivalent_conicity(standard.displacement, standard.difference, FAMILY_AMPLITUDES)
    low, high = USUAL_CONICITY
    if not (np.isfinite(true).all() and low <= true[-1] <= high):
        return None
    phi = np.interp(ran.displacement, FAMILY_GRID, table.roll[:, 0])
    x = standard_displacement(ran.displacement, phi, wheelset.left_radius, level=roll is ContactRoll.HIDDEN)
    curves = [_curve(x, ran.difference, roll, said) for said in (None, roll)]
    estimates = [curve_estimates(curve, CurveParameters(amplitudes=FAMILY_AMPLITUDES)).conicity for curve in curves]
    values = np.array([[(e.value, e.high) for e in conicities] for conicities in estimates], dtype=np.float64)
    errors = np.stack([values[..., 0] - true, values[..., 1] - values[..., 0]], axis=-1)
    return errors if np.isfinite(errors).all() else None


def _curve(x: FloatArray, difference: FloatArray, roll: ContactRoll, said: ContactRoll | None) -> CurveReplicates:
    """Return R in bins, without noise, as a quadratic in each."""
    edges = BinParameters(reach=FAMILY_REACH).edges
    u = (np.arange(IN_BIN) + 0.5) / IN_BIN - 0.5
    at = 0.5 * (edges[:-1] + edges[1:])[:, None] + (edges[1] - edges[0]) * u
    further = np.maximum.accumulate(x)
    rises = np.append(True, np.diff(further) > 0.0)
    values = np.interp(at, further[rises], difference[rises])
    shape = values @ np.linalg.pinv(np.vander(u, 3, increasing=True)).T
    return CurveReplicates(
        edges,
        np.repeat(shape[None], 1 + GROUPS, axis=0),
        np.zeros((len(shape), 0, 3)),
        np.ones(len(shape), dtype=np.bool_),
        DisplacementError(0.0, 0.0, SCALE_STDS[roll]),
        1.0,
        band_limited=False,
        contact_roll=said,
    )


def _text(values: FloatArray) -> str:
    return " / ".join(f"{value:.4f}" for value in values)


def _percents(shares: FloatArray) -> str:
    return " / ".join(f"{100 * share:.0f}" for share in shares)


AMPLITUDES = np.array([2.0e-3, 2.5e-3, 3.0e-3])
GRID = 0.01e-3 * np.arange(-1100, 1101)  # m
SPEED, SECONDS, ALIGNMENT_STD, SEED = 20.0, 400.0, 2.0e-3, 15302
REACH, REACH_SHARE = 0.0005, 0.005
P8_SLOPE = 0.228  # lambda of P8 on 60E1 1:40, which is straight
BOGIES = ("coach", "soft_bogie", "freight")
OPPOSITE = (0.5e-3, -0.5e-3)  # m, rho of the front and the rear wheelset: 1 mm of diameter each
HELD_REACH = 0.06e-3  # m
FORMS = ("level", "rolling", "axle")
ROLLS = {"level": ContactRoll.SEEN, "rolling": ContactRoll.HIDDEN}


@dataclass(frozen=True, slots=True)
class Pair:
    """A wheel, as worn as it is, on a rail."""

    name: str
    wheel: Profile
    rail: str
    inclination: int  # 1 : inclination


def pairs() -> Iterator[Pair]:
    """Yield new and worn pairs on rails of 1:20 and 1:40."""
    p8, s1002 = wheel_profile("P8"), wheel_profile("S1002")
    yield Pair("P8, new", p8, "56E1", 20)
    yield Pair("P8, new", p8, "60E1", 40)
    for depth in (0.5e-3, 1.0e-3):
        yield Pair(f"P8, worn {1e3 * depth:g} mm", worn(p8, wear_course(WearFamily.P8_ON_56E1, depth)), "56E1", 20)
    yield Pair("S1002, new", s1002, "60E1", 40)
    yield Pair("S1002, new", s1002, "60E1", 20)
    for depth in (0.3e-3, 0.6e-3, 1.0e-3, 1.5e-3):
        hollow = worn(s1002, TreadWear(depth, 4e-3, 33e-3, depth))
        yield Pair(f"S1002, hollow {1e3 * depth:g} mm", hollow, "60E1", 40)
    cone = wheel_profile("EN13715-1/40/h28/e32.5")
    yield Pair("cone of 1:40, new", cone, "60E1", 20)
    yield Pair("cone of 1:40, new", cone, "60E1", 40)
    yield Pair("cone of 1:40, worn 0.8 mm", worn(cone, TreadWear(0.8e-3, 3e-3, 38e-3, 0.8e-3)), "60E1", 40)
    for letter in "ABH":
        yield Pair(f"wheel {letter} of EN 15302", wheel_profile(f"EN15302-{letter}"), "60E1", 40)


def rows(errors: Family) -> Iterator[BenchRow]:
    """Yield a row for each pair, those of the worn family, and for each class what it holds off the rolling line."""
    for pair in pairs():
        yield _row(pair, *biases(pair))
    for roll, of_roll in errors.items():
        yield _family_row(roll, of_roll)
    for code in BOGIES:
        yield _held(shipped_class(code))


def biases(pair: Pair) -> tuple[FloatArray, Mapping[str, FloatArray]]:
    """Return the true conicity (3,), and by form of the estimate error and half width (2, 3), at 2, 2.5 and 3 mm."""
    vehicle = VehicleParameters()
    wheelset = WheelsetOnTrack.symmetric(
        pair.wheel, rail_profile(pair.rail), 1.0 / pair.inclination, 1.435, radius=vehicle.nominal_radius
    )
    curve = radius_difference_curve(wheelset, GRID[::10])
    true = equivalent_conicity(curve.displacement, curve.difference, AMPLITUDES)
    ran = _run(wheelset, vehicle)
    estimated = {form: _estimated(ran, vehicle, form) for form in FORMS}
    return true, {form: np.stack([value - true, high - value]) for form, (value, high) in estimated.items()}


def _run(wheelset: WheelsetOnTrack, vehicle: VehicleParameters) -> WheelsetMotion:
    track = make_track(
        TrackRecipe(length=SPEED * SECONDS + 100.0, alignment_std=ALIGNMENT_STD), np.random.SeedSequence(SEED)
    )
    table = contact_table(wheelset, GRID, outside="hold")
    return simulate_gear(RunningGear(vehicle), [table], track, np.full(round(SECONDS / STEP), SPEED), 20.0)[0]


def _estimated(ran: WheelsetMotion, vehicle: VehicleParameters, form: str) -> FloatArray:
    """Return conicities and the upper ends of their intervals (2, 3)."""
    motion = ideal_motion(ran)
    if form != "axle":
        x = standard_displacement(motion.displacement, motion.roll, vehicle.nominal_radius, level=form == "rolling")
        motion = replace(motion, displacement=x)
    parameters = bin_table.BinParameters(vehicle=vehicle)
    roll = ROLLS.get(form)
    scale = 0.0 if roll is None else SCALE_STDS[roll]
    of_roll = ParameterUncertainty(0.0, 0.0, 0.0, inverse_friction=(0.0, 0.0), displacement=scale, contact_roll=roll)
    geometry = estimate_geometry(
        bin_table.tabulate(motion, parameters), parameters, GeometryParameters(uncertainty=of_roll)
    )
    places = [int(np.argmin(np.abs(geometry.amplitude - amplitude))) for amplitude in AMPLITUDES]
    conicities = [geometry.conicity[k] for k in places]
    return np.array([[c.value for c in conicities], [c.high for c in conicities]], dtype=np.float64)


def _held(known: VehicleClass) -> BenchRow:
    """Return what is left in R where wheels of both axles differ by 1 mm in diameter: simulated, and by the balance."""
    p, wheel, rail = known.parameters, wheel_profile("P8"), rail_profile("60E1")
    tables = []
    for rho in OPPOSITE:
        left, right = p.nominal_radius + 0.5 * rho, p.nominal_radius - 0.5 * rho
        wheelset = WheelsetOnTrack(wheel, wheel, rail, rail, 1 / 40, 1.435, left, right)
        tables.append(contact_table(wheelset, GRID[::5], outside="hold"))
    track = make_track(TrackRecipe(length=1300.0), np.random.SeedSequence(SEED))
    speed = np.full(60_000, SPEED)
    ran = simulate_gear(RunningGear(p, known.bogie), tables, track, speed, 20.0)
    found = np.array([(one.rolling_radius_left - one.rolling_radius_right)[10_000:].mean() for one in ran])
    expected = left_in_difference(known, P8_SLOPE) @ OPPOSITE
    shares = np.interp((0.2, 0.4), SLOPES, held_shares(known))
    said = " / ".join(f"{1e3 * one:+.2f}" for one in found)
    balance = " / ".join(f"{1e3 * one:+.2f}" for one in expected)
    return BenchRow(
        f"{known.code}, 1 mm between the wheels of both axles, opposite: mean of R, front / rear",
        f"{said} mm simulated, {balance} mm by the balance;"
        f" share at a conicity of 0.1 / 0.2: {shares[0]:.2f} / {shares[1]:.2f}",
        "0.06 mm",
        bool((np.abs(found - expected) <= HELD_REACH).all()),
    )


def _row(pair: Pair, true: FloatArray, errors: Mapping[str, FloatArray]) -> BenchRow:
    said = "; ".join(
        f"{name} {_percent(errors[form], true, with_interval=form in ROLLS)}" for form, name in _NAMES.items()
    )
    met = all((np.abs(errors[form][0]) <= REACH + REACH_SHARE * true).all() for form in ROLLS)
    text = " / ".join(f"{one:.3f}" for one in true)
    return BenchRow(f"{pair.name}, {pair.rail} 1:{pair.inclination}: {text}", said, "0.5 % + 0.0005", met)


_NAMES = {
    "level": "level track",
    "rolling": "track that may roll",
    "axle": "before: axle",
}


def _percent(error: FloatArray, true: FloatArray, *, with_interval: bool) -> str:
    bias, half = 100 * error / true
    text = " / ".join("-" if np.isnan(one) else f"{one:+.1f}" for one in bias) + " %"
    return text + (" (half width " + " / ".join(f"{one:.1f}" for one in half) + ")" if with_interval else "")


def _parts(_options: argparse.Namespace, _folder: Path) -> list[Part]:
    errors = family()
    return [row_table(printed(rows(errors))), family_figures(errors)]


main = Bench("en15302", "Conicity of wheelsets in motion against EN 15302", __doc__ or "", _parts).run
