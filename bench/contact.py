"""Contact geometry: against the reference results of EN 15302, and the time for a full table."""

from __future__ import annotations

import statistics
import time
from collections.abc import Iterator

import numpy as np

from bench.report import BenchRow
from estimation.contact.conicity import equivalent_conicity
from estimation.contact.geometry import WheelsetOnTrack, contact_table
from estimation.contact.profiles import rail_profile, wheel_profile
from estimation.contact.table import ContactMethod, ContactTable

# EN 15302:2021, wheels A and C on rail A at 1435.16 mm: Delta r (mm) at shifts (mm), tan(gamma_e) at 1 to 6 mm
SHIFTS_MM = (0.5, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0)
DELTA_R_MM = {
    "A": (0.116, 0.259, 0.667, 1.243, 1.913, 2.936, 4.327),
    "C": (0.515, 1.024, 1.271, 1.402, 1.533, 1.665, 1.801),
}
TAN_GAMMA = {
    "A": (0.125, 0.155, 0.188, 0.216, 0.254, 0.303),
    "C": (0.515, 0.365, 0.271, 0.221, 0.191, 0.170),
}
TAN_REACH = {"A": 0.003, "C": 0.01}
RUNS = 7


def rows() -> Iterator[BenchRow]:
    """Yield the rows on contact geometry."""
    for wheel in ("A", "C"):
        table = _reference_table(wheel)
        y, difference = table.lateral_displacement, table.rolling_radius_difference[:, 0]
        computed = np.interp(np.array(SHIFTS_MM) * 1e-3, y, difference) * 1e3
        rms = float(np.sqrt(np.mean((computed - DELTA_R_MM[wheel]) ** 2)))
        yield BenchRow(f"Delta r, EN 15302 wheel {wheel} on rail A", f"{rms:.4f} mm rms", "0.005 mm rms", rms <= 0.005)
        reference = np.array(TAN_GAMMA[wheel])
        error = np.abs(equivalent_conicity(y, difference, np.arange(1, 7) * 1e-3) - reference)
        inside = bool((error <= np.minimum(0.05, 0.5 * reference)).all())
        yield BenchRow(
            f"tan(gamma_e) at 1-6 mm, EN 15302 wheel {wheel} on rail A",
            f"{error.max():.4f} largest, {'inside' if inside else 'OUTSIDE'} the tolerance",
            f"{TAN_REACH[wheel]}, inside the tolerance",
            bool(error.max() <= TAN_REACH[wheel]) and inside,
        )
    for wheel_name, rail_name, inclination in (("P8", "56E1", 1 / 20), ("S1002", "60E1", 1 / 40)):
        yield _timed(wheel_name, rail_name, inclination)


def _reference_table(wheel: str) -> ContactTable:
    wheelset = WheelsetOnTrack.symmetric(
        wheel_profile(f"EN15302-{wheel}"), rail_profile("EN15302-A"), 0.0, 1.43516, radius=0.46
    )
    return contact_table(wheelset, np.arange(-900, 901) * 1e-5, method=ContactMethod.EN15302)


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
