"""The paper's two simulations, what the two estimators make of them, and its figures 3, 4, 6 and 7, as numbers too.

One wheelset with a worn P8 profile on a new 113A rail (56E1), Table A.1 at 20 m/s, ideal sensors, alignment of 2 mm
standard deviation; first at constant gauge, then with a gauge variation of 2 mm standard deviation. The alignment is
known to the estimators, the gauge is not.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from estimation.contact.geometry import ContactTable, WheelsetOnTrack, contact_table
from estimation.contact.profiles import rail_profile, wheel_profile
from estimation.contact.wear import WearFamily, wear_course, worn
from estimation.estimators import paper_algorithm
from estimation.geometry.estimate import GeometryParameters, estimate_geometry
from estimation.geometry.uncertainty import ParameterUncertainty
from estimation.tables import bin_table
from estimation.values.arrays import FloatArray
from estimation.values.fields import JsonValue
from estimation.values.geometry import COMBINATIONS, BinStatus, WheelsetGeometry
from estimation.values.windows import Motion
from estimation.vehicle.vehicle_class import VehicleParameters
from ingest.simulator.motion import STEP, WheelsetMotion
from ingest.simulator.running_gear import RunningGear, simulate_gear
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
    printed: paper_algorithm.PaperGeometry
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
    motion = simulate_gear(RunningGear(), [table], track, speed, 20.0)[0]
    seen = ideal_motion(motion)
    parameters = bin_table.BinParameters()
    certain = GeometryParameters(uncertainty=ParameterUncertainty(0.0, 0.0, 0.0, inverse_friction=(0.0, 0.0)))
    estimate = estimate_geometry(bin_table.tabulate(seen, parameters), parameters, certain)
    algorithm = paper_algorithm.PaperAlgorithm(width=parameters.width)
    printed = paper_algorithm.estimate(seen, VehicleParameters(), algorithm)
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
    middles = 0.5 * (x[:-1] + x[1:])
    jump = np.array([step[(middles >= a) & (middles < b)].max(initial=0.0) for a, b in pairwise(edges)])
    return truth, jump


TITLES = {
    "rolling_radius_sum": r"$r_L + r_R$ (mm)",
    "rolling_radius_difference": r"$r_L - r_R$ (mm)",
    "contact_angle_sum": r"$\delta_L + \delta_R$ (rad)",
    "contact_angle_difference": r"$\delta_L - \delta_R$ (rad)",
}
SCALE = {name: 1e3 if name.startswith("rolling") else 1.0 for name in COMBINATIONS}
TRUTH, OURS, PRINTED, CLOUD = "#444444", "#0b6e99", "#d1495b", "#c9c9c9"
LABEL_X = "lateral displacement y - d (mm)"
SHOWN = 20  # every so many samples of the cloud
LEAST_SAMPLES = 500


def figure_3(table: ContactTable) -> Figure:
    """Draw the contact geometries at nominal gauge: rolling radii and contact angles of both wheels."""
    figure = Figure(figsize=(9, 6.4), layout="constrained")
    axes = figure.subplots(2, 2, sharex=True)
    x = 1e3 * table.lateral_displacement
    column = int(np.argmin(np.abs(table.gauge_deviation)))
    panels = (
        (axes[0, 0], table.rolling_radius_left, 1e3, r"$r_L$ (mm)"),
        (axes[0, 1], table.rolling_radius_right, 1e3, r"$r_R$ (mm)"),
        (axes[1, 0], table.contact_angle_left, 1.0, r"$\delta_L$ (rad)"),
        (axes[1, 1], table.contact_angle_right, 1.0, r"$\delta_R$ (rad)"),
    )
    broken = _broken(table, column)
    for ax, values, scale, label in panels:
        ax.plot(x, np.where(broken, np.nan, scale * values[:, column]), color=TRUTH, linewidth=1.4)
        ax.set_ylabel(label)
        ax.grid(alpha=0.3)
    for ax in axes[1]:
        ax.set_xlabel(LABEL_X)
    figure.suptitle("Fig. 3: wheel-rail contact geometries, worn P8 on new 113A")
    return figure


def figure_4(case: Case) -> Figure:
    """Show that the rolling radius sum is a cloud when the gauge varies."""
    figure = Figure(figsize=(9, 4.6), layout="constrained")
    ax = figure.subplots()
    x = 1e3 * case.motion.relative_displacement[::SHOWN]
    total = 1e3 * (case.motion.rolling_radius_left + case.motion.rolling_radius_right)[::SHOWN]
    ax.plot(x, total, ".", markersize=1.2, color=CLOUD, label="as run through, gauge varying by 2 mm (1 std)")
    table = case.table
    column = int(np.argmin(np.abs(table.gauge_deviation)))
    line = np.where(_broken(table, column), np.nan, 1e3 * table.rolling_radius_sum[:, column])
    ax.plot(1e3 * table.lateral_displacement, line, color=TRUTH, label="nominal gauge")
    ax.set(xlabel=LABEL_X, ylabel=TITLES["rolling_radius_sum"], xlim=(x.min() - 0.2, x.max() + 0.2))
    ax.set_ylim(total.min() - 0.3, total.max() + 0.3)
    ax.legend(loc="upper center", markerscale=8)
    ax.grid(alpha=0.3)
    figure.suptitle("Fig. 4: effect of the uncertainty of the gauge")
    return figure


def figure_estimates(case: Case, title: str) -> Figure:
    """Draw all four combinations: truth, the paper's algorithm, and locally linear bins with their intervals."""
    figure = Figure(figsize=(11, 8), layout="constrained")
    for ax, name in zip(figure.subplots(2, 2, sharex=True).ravel(), COMBINATIONS, strict=True):
        _panel(ax, case, name)
    figure.axes[0].legend(loc="upper center", fontsize=8, markerscale=1.5)
    figure.suptitle(title)
    return figure


def _panel(ax: Axes, case: Case, name: str) -> None:
    scale = SCALE[name]
    centre = 1e3 * case.estimate.bin_centres
    motion = case.motion
    left, right = (
        (motion.rolling_radius_left, motion.rolling_radius_right)
        if name.startswith("rolling")
        else (motion.contact_angle_left, motion.contact_angle_right)
    )
    true = scale * (left + right if name.endswith("sum") else left - right)[::SHOWN]
    ax.plot(1e3 * motion.relative_displacement[::SHOWN], true, ".", markersize=1.5, color=CLOUD, label="truth")
    enough = case.printed.samples > LEAST_SAMPLES
    ax.plot(
        1e3 * case.printed.centre[enough],
        scale * getattr(case.printed, name)[enough],
        "x",
        markersize=4.5,
        color=PRINTED,
        label="the paper's algorithm",
    )
    values = getattr(case.estimate, name)
    ax.errorbar(
        centre, scale * values.value, yerr=1.96 * scale * values.std, fmt="o", markersize=3, capsize=2, color=OURS,
        label="locally linear bins, 95 %",
    )  # fmt: skip
    jumps = np.array([status is BinStatus.CONTACT_JUMP for status in values.status])
    for x in centre[jumps]:
        ax.axvspan(x - 0.125, x + 0.125, color="#f2c14e", alpha=0.25, linewidth=0)
    margin = max(0.35 * (true.max() - true.min()), 1e-3)
    ax.set_ylim(true.min() - margin, true.max() + margin)
    ax.set_ylabel(TITLES[name])
    ax.set_xlabel(LABEL_X)
    ax.grid(alpha=0.3)


def _broken(table: ContactTable, column: int) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """Return where a line must be interrupted: the first grid point of each contact jump."""
    jump = table.jump[:, column]
    return np.asarray(jump & np.append(jump[1:], False))


SYMBOLS = {
    "rolling_radius_sum": "rL+rR (mm)",
    "rolling_radius_difference": "rL-rR (mm)",
    "contact_angle_sum": "dL+dR (rad)",
    "contact_angle_difference": "dL-dR (rad)",
}


def numbers(contact: ContactTable, cases: Mapping[str, Case], seed: int) -> dict[str, JsonValue]:
    """Return the study as JSON values; lengths in mm, angles in rad, null where nothing is published."""
    column = int(np.argmin(np.abs(contact.gauge_deviation)))
    return {
        "case": {
            "wheel": "P8",
            "tread_wear_mm": 1e3 * WEAR_DEPTH,
            "rail": "56E1 (BS 113A)",
            "inclination": INCLINATION,
            "gauge_mm": 1e3 * GAUGE,
            "speed_m_s": SPEED,
            "alignment_std_mm": 1e3 * STANDARD_DEVIATION,
            "seed": seed,
        },
        "figure_3": {
            "lateral_displacement_mm": _list(1e3 * contact.lateral_displacement),
            "rolling_radius_left_mm": _list(1e3 * contact.rolling_radius_left[:, column]),
            "rolling_radius_right_mm": _list(1e3 * contact.rolling_radius_right[:, column]),
            "contact_angle_left_rad": _list(contact.contact_angle_left[:, column]),
            "contact_angle_right_rad": _list(contact.contact_angle_right[:, column]),
        },
        "figure_4": _cloud(cases["figure_7"]),
        **{name: _estimates(case) for name, case in cases.items()},
    }


def page(title: str, case: Case) -> str:
    """Return a Markdown page of a figure: estimate against truth per bin with enough samples."""
    head = ["y-d (mm)", "samples"]
    for name in COMBINATIONS:
        head += [f"{SYMBOLS[name]} true", "bins", "paper"]
    lines = ["| " + " | ".join(head) + " |", "|" + " ---: |" * len(head)]
    centre = case.estimate.bin_centres
    lines += [
        "| " + " | ".join([f"{1e3 * centre[b]:.2f}", f"{case.estimate.samples[b]:.0f}", *_cells(case, b)]) + " |"
        for b in np.flatnonzero(case.estimate.samples > LEAST_SAMPLES).tolist()
    ]
    return "\n".join([f"# {title}", "", "Written by `treadwatch reproduce`.", "", *lines, ""])


def _cells(case: Case, b: int) -> list[str]:
    cells = []
    printed = _printed_at(case)
    for name in COMBINATIONS:
        scale = SCALE[name]
        values = getattr(case.estimate, name)
        status = values.status[b].value
        ours = (
            f"{scale * values.value[b]:.3f} ± {1.96 * scale * values.std[b]:.3f}" if status == "estimated" else status
        )
        cells += [f"{scale * case.truth[name][b]:.3f}", ours, f"{scale * printed[name][b]:.3f}"]
    return cells


def _estimates(case: Case) -> dict[str, JsonValue]:
    printed = _printed_at(case)
    result: dict[str, JsonValue] = {
        "gauge_std_mm": 1e3 * case.gauge_std,
        "lateral_displacement_mm": _list(1e3 * case.estimate.bin_centres),
        "samples": _list(case.estimate.samples),
        "contact_jump_inside_mm": _list(1e3 * case.jump),
    }
    for name in COMBINATIONS:
        unit = "mm" if name.startswith("rolling") else "rad"
        values = getattr(case.estimate, name)
        result[f"{name}_{unit}"] = {
            "truth": _list(SCALE[name] * case.truth[name]),
            "estimate": _list(SCALE[name] * values.value),
            "std": _list(SCALE[name] * values.std),
            "status": [status.value for status in values.status],
            "paper": _list(SCALE[name] * printed[name]),
        }
    return result


def _cloud(case: Case) -> dict[str, JsonValue]:
    edges = case.estimate.bin_edges
    total = case.motion.rolling_radius_left + case.motion.rolling_radius_right
    index = np.digitize(case.motion.relative_displacement, edges) - 1
    met = [total[index == b] for b in range(len(edges) - 1)]
    quantiles = np.array([np.quantile(m, (0.05, 0.5, 0.95)) if len(m) else (np.nan,) * 3 for m in met])
    return {
        "lateral_displacement_mm": _list(1e3 * case.estimate.bin_centres),
        **{
            f"rolling_radius_sum_{name}_mm": _list(1e3 * column)
            for name, column in zip(("p05", "p50", "p95"), quantiles.T, strict=True)
        },
    }


def _printed_at(case: Case) -> dict[str, FloatArray]:
    """Return the paper's estimates at the bins of ours (the same width, both centred on zero)."""
    width = case.estimate.bin_edges[1] - case.estimate.bin_edges[0]
    place = np.rint((case.estimate.bin_centres - case.printed.centre[0]) / width).astype(np.int64)
    inside = (place >= 0) & (place < len(case.printed.centre))
    nearest = np.where(inside, place, 0)
    return {name: np.where(inside, getattr(case.printed, name)[nearest], np.nan) for name in COMBINATIONS}


def _list(values: FloatArray) -> list[JsonValue]:
    return [float(f"{value:.9g}") if np.isfinite(value) else None for value in values]
