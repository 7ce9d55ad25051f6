"""Contact geometry: against the reference results of EN 15302, with noise, and the time for a full table."""

from __future__ import annotations

import json
import statistics
import time
from collections.abc import Iterator

import numpy as np

from api.terminal.contact import Contact, FileOptions, measured_shapes, table_text
from bench.contact_noise import noise_rows
from bench.report import BenchRow
from estimation.contact.conicity import equivalent_conicity
from estimation.contact.geometry import ContactMethod, WheelsetOnTrack, contact_table
from estimation.contact.profiles import rail_profile, wheel_profile
from estimation.values.arrays import FloatArray

# Delta r (mm) at shifts (mm) and tan(gamma_e) at 1 to 6 mm of wheels on rail A at 1435.16 mm. Wheels A and C:
# EN 15302:2021; B, H and I: EN 15302:2008 Annex E, whose Delta r is given, and interpolated, at steps of 0.1 mm, so
# that a jump is up to 0.1 mm off; there the tolerance of the standard counts, min(0.05, tan(gamma_e) / 2).
SHIFTS_MM = (0.5, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0)
DELTA_R_MM = {
    "A": (0.116, 0.259, 0.667, 1.243, 1.913, 2.936, 4.327),
    "C": (0.515, 1.024, 1.271, 1.402, 1.533, 1.665, 1.801),
}
TAN_GAMMA = {
    "A": (0.125, 0.155, 0.188, 0.216, 0.254, 0.303),
    "C": (0.515, 0.365, 0.271, 0.221, 0.191, 0.170),
    "B": (0.025, 0.025, 0.058, 0.241, 0.283, 0.302),
    "H": (0.025, 0.025, 0.245, 0.319, 0.306, 0.284),
    "I": (0.000, 0.293, 0.489, 0.485, 0.475, 0.447),
}
EXACT = ("A", "C")
REACH = 0.001
LEAST_TOLERANCE = 0.01  # of the standard where tan(gamma_e) is nearly 0
FINE_STEP = 1e-6  # m
JUMP_NEAR = 0.15e-3  # m, an amplitude ends on a jump that is this near
RUNS = 7


def rows() -> Iterator[BenchRow]:
    """Yield the rows on contact geometry."""
    for wheel in DELTA_R_MM:
        yield _radii(wheel)
    for wheel in TAN_GAMMA:
        yield _against_standard(wheel)
    yield from _against_fine_grid()
    yield from noise_rows()
    for wheel_name, rail_name, inclination in (("P8", "56E1", 1 / 20), ("S1002", "60E1", 1 / 40)):
        yield _timed(wheel_name, rail_name, inclination)


def _radii(wheel: str) -> BenchRow:
    table = contact_table(_reference(wheel), np.arange(-900, 901) * 1e-5, method=ContactMethod.EN15302)
    y, difference = table.lateral_displacement, table.rolling_radius_difference[:, 0]
    computed = np.interp(np.array(SHIFTS_MM) * 1e-3, y, difference) * 1e3
    rms = float(np.sqrt(np.mean((computed - DELTA_R_MM[wheel]) ** 2)))
    return BenchRow(f"Delta r, EN 15302 wheel {wheel} on rail A", f"{rms:.4f} mm rms", "0.005 mm rms", rms <= 0.005)


def _against_standard(wheel: str) -> BenchRow:
    amplitude, conicity, _ = _printed(wheel)
    reference = np.array(TAN_GAMMA[wheel])
    error = np.abs(conicity[np.isin(amplitude, np.arange(1.0, 7.0))] - reference)
    inside = bool((error <= np.clip(0.5 * reference, LEAST_TOLERANCE, 0.05)).all())
    largest = REACH if wheel in EXACT else 0.05
    return BenchRow(
        f"tan(gamma_e) at 1-6 mm, EN 15302 wheel {wheel} on rail A, edition {2021 if wheel in EXACT else 2008}",
        f"{error.max():.4f} largest, {'inside' if inside else 'OUTSIDE'} the tolerance",
        f"{REACH}, inside the tolerance" if wheel in EXACT else "inside the tolerance",
        bool(error.max() <= largest) and inside,
    )


def _against_fine_grid() -> Iterator[BenchRow]:
    """Compare with a search every 1 um, which needs no jump to be placed."""
    away, near = [], []
    for wheel in TAN_GAMMA:
        amplitude, conicity, jumps = _printed(wheel)
        y = FINE_STEP * np.arange(-8000, 8001)
        table = contact_table(_reference(wheel), y, method=ContactMethod.EN15302, outside="hold")
        truth = equivalent_conicity(y, table.rolling_radius_difference[:, 0], amplitude * 1e-3)
        usable = amplitude <= 6.0
        on_jump = np.array([np.min(np.abs(jumps - a), initial=np.inf) < JUMP_NEAR * 1e3 for a in amplitude])
        error = np.abs(conicity - truth)
        away.append(error[usable & ~on_jump])
        near.append((error / np.clip(0.5 * truth, LEAST_TOLERANCE, 0.05))[usable & on_jump])
    what = f"tan(gamma_e) at 0.5-6 mm by 0.1 mm, wheels {', '.join(TAN_GAMMA)}, against a search every 1 um"
    largest, share = float(np.concatenate(away).max()), float(np.concatenate(near).max())
    yield BenchRow(f"{what}, away from jumps", f"{largest:.4f} largest", f"{REACH}", largest <= REACH)
    yield BenchRow(
        f"{what}, end of the amplitude on a jump",
        f"{share:.1%} of the tolerance at most, {len(np.concatenate(near))} amplitudes",
        "100 % of the tolerance",
        share <= 1.0,
    )


def _reference(wheel: str) -> WheelsetOnTrack:
    return WheelsetOnTrack.symmetric(
        wheel_profile(f"EN15302-{wheel}"), rail_profile("EN15302-A"), 0.0, 1.43516, radius=0.46
    )


def _printed(wheel: str) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return amplitudes (mm), tan(gamma_e) and contact jumps (mm) as the command prints them."""
    shapes = measured_shapes((f"EN15302-{wheel}",) * 2, "EN15302-A", FileOptions())
    document = json.loads(table_text(Contact(_reference(wheel), shapes, ContactMethod.EN15302, "0"), as_json=True))
    conicity = document["equivalent_conicity"]
    values = (conicity["amplitude_mm"], conicity["value"], document["contact_jumps_mm"])
    amplitude, value, jumps = (np.array(column, dtype=np.float64) for column in values)
    return amplitude, value, jumps


def _timed(wheel_name: str, rail_name: str, inclination: float) -> BenchRow:
    wheelset = WheelsetOnTrack.symmetric(wheel_profile(wheel_name), rail_profile(rail_name), inclination, 1.435)
    displacement, deviation = np.linspace(-8e-3, 8e-3, 161), np.linspace(-6e-3, 6e-3, 13)
    contact_table(wheelset, displacement, deviation)
    times = []
    for _ in range(RUNS):
        start = time.perf_counter()
        contact_table(wheelset, displacement, deviation)
        times.append(time.perf_counter() - start)
    seconds = statistics.median(times)
    what = f"contact table 161 x 13, rigid with roll, {wheel_name} on {rail_name}"
    return BenchRow(what, f"{seconds:.3f} s (median of {RUNS})", "< 0.3 s on one core", seconds < 0.3)
