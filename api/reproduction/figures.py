"""The paper's figures 3, 4, 6 and 7, drawn from a study."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from api.reproduction.study import Case
from estimation.contact.geometry import ContactTable
from estimation.values.geometry import COMBINATIONS, BinStatus

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
