"""Draw docs/img/axes.png: the axes and signs that every module shares. Run: python docs/figures/axes.py."""  # noqa: INP001 - a script, not a package

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import FancyArrowPatch, Polygon, Rectangle

from estimation.contact.geometry import WheelsetOnTrack, contact_table
from estimation.contact.profiles import rail_profile, wheel_profile

INK, LEFT, RIGHT, STEEL, DIMENSION = "#222222", "#1f5fa8", "#c4561a", "#d9dee3", "#5b7083"
SQUEEZE = 590.0  # mm taken out of each half of the rear view, so that the profiles can be seen


def main() -> None:
    """Write the picture."""
    figure = Figure(figsize=(12.0, 10.6), layout="constrained")
    FigureCanvasAgg(figure)
    rear, top = figure.subplots(2, 1, height_ratios=[1.35, 1.0])
    _rear_view(rear)
    _top_view(top)
    target = Path(__file__).resolve().parent.parent / "img" / "axes.png"
    target.parent.mkdir(exist_ok=True)
    figure.savefig(target, dpi=110)


def _rear_view(axes: Axes) -> None:
    """Draw the wheelset from behind, left on the left: lateral +y points to the left of the page."""
    wheel, rail = wheel_profile("P8"), rail_profile("56E1")
    wheelset = WheelsetOnTrack.symmetric(wheel, rail, 1 / 20, 1.435)
    table = contact_table(wheelset, [0.0])
    contact = float(table.contact_position_left[0, 0]) * 1e3
    across = float(table.rail_position_left[0, 0]) * 1e3 - SQUEEZE
    height = float(wheel.height(np.array([contact * 1e-3]))[0]) * 1e3
    for sign, colour, name in ((-1, LEFT, "L"), (1, RIGHT, "R")):
        _wheel_and_rail(axes, sign, colour, (across, contact, height), float(table.contact_angle_left[0, 0]), name)
    _frame(axes, across - contact - 70.0)
    _dimensions(axes, across - contact - 70.0)
    axes.set_title("Rear view (looking forward, x into the page)", fontsize=12)
    axes.set_xlim(-265, 265)
    axes.set_ylim(-92, 150)
    axes.set_aspect("equal")
    axes.axis("off")


def _wheel_and_rail(
    axes: Axes, sign: int, colour: str, place: tuple[float, float, float], angle: float, name: str
) -> None:
    across, contact, height = place
    wheel, rail = wheel_profile("P8"), rail_profile("56E1")
    tread = [(sign * (y + across - contact), height - z) for y, z in zip(wheel.y * 1e3, wheel.z * 1e3, strict=True)]
    outline = [*tread, (tread[-1][0], 78.0), (tread[0][0], 78.0)]
    axes.add_patch(Polygon(outline, closed=True, facecolor=STEEL, edgecolor=colour, linewidth=1.6))
    tilt = math.atan(1 / 20)
    y = rail.y * 1e3 * math.cos(tilt) + rail.z * 1e3 * math.sin(tilt)
    z = rail.z * 1e3 * math.cos(tilt) - rail.y * 1e3 * math.sin(tilt)
    y = y - y.min() + 1435.0 / 2 - SQUEEZE
    head = [(sign * a, -b - (0.0 - z.min())) for a, b in zip(y, z, strict=True)]
    foot = [(sign * (y.mean() + 12.0), -45.0), (sign * (y.mean() - 12.0), -45.0)]
    axes.add_patch(Polygon([*head, *foot], closed=True, facecolor="#eceff1", edgecolor=INK, linewidth=1.4))
    axes.plot([sign * across], [0.0], "o", color=colour, markersize=6, zorder=5)
    for slope, style in ((0.0, ":"), (math.tan(angle), "-")):
        axes.plot([sign * (across - 45), sign * (across + 62)], [-45 * slope, 62 * slope], style, color=colour, lw=1.3)
    axes.text(
        sign * (across + 66), 1.5, f"$\\delta_{name}>0$", color=colour, fontsize=12, ha="left" if sign > 0 else "right"
    )
    axes.text(sign * (across + 5), 84, "left wheel" if name == "L" else "right wheel", color=colour, ha="center")
    axes.annotate(
        f"$r_{name}$", (sign * across, 2), (sign * across, 70), ha="center", color=colour, fontsize=12,
        arrowprops={"arrowstyle": "->", "color": colour},
    )  # fmt: skip
    axes.text(sign * 220, -60, "field side", ha="center", color=DIMENSION)


def _frame(axes: Axes, back: float) -> None:
    axes.add_patch(Rectangle((-back, 62), 2 * back, 10, facecolor=STEEL, edgecolor=INK, lw=1.0))
    axes.plot([0, 0], [-78, 140], "-.", color=DIMENSION, lw=0.9)
    axes.text(3, -86, "track centre", color=DIMENSION, fontsize=9, va="bottom")
    for end, label, spot in (((-46, 104), "+y (left)", (-48, 108)), ((0, 140), "+z (up)", (4, 138))):
        axes.add_patch(FancyArrowPatch((0, 104), end, arrowstyle="-|>", mutation_scale=15, color=INK, lw=1.8))
        axes.text(*spot, label, fontsize=11, ha="right" if end[0] < 0 else "left")
    arc = FancyArrowPatch(
        (-62, 52), (-62, 84), connectionstyle="arc3,rad=-0.45", arrowstyle="-|>", mutation_scale=14, color=INK, lw=1.6
    )
    axes.add_patch(arc)
    axes.text(-60, 43, r"$\phi>0$ lifts the left wheel", fontsize=10, ha="left")
    for x in (-36, 36):
        axes.plot([x - 3, x + 3], [58, 76], color="white", lw=4)
        axes.plot([x - 4, x + 2], [58, 76], color=INK, lw=0.8)
        axes.plot([x - 2, x + 4], [58, 76], color=INK, lw=0.8)


def _dimensions(axes: Axes, back: float) -> None:
    """Draw gauge, flange-back distance and tread datum; ``back`` is where the flange back is drawn."""
    edge = 1435.0 / 2 - SQUEEZE
    for half, level, label in (
        (edge, -14.0, "track gauge, 14 mm below the top of the rails"),
        (back, 22.0, "flange-back distance 1360 mm"),
    ):
        axes.annotate("", (-half, level), (half, level), arrowprops={"arrowstyle": "<->", "color": DIMENSION})
        axes.text(0, level + 2.0, label, ha="center", color=DIMENSION, fontsize=9.5, backgroundcolor="white")
    for sign in (-1, 1):
        axes.plot([sign * back, sign * back], [18, 60], color=DIMENSION, lw=0.8)
        datum = sign * (back + 70.0)
        axes.plot([datum, datum], [-4, 126], "--", color=DIMENSION, lw=0.9)
        axes.annotate("", (sign * back, 112), (datum, 112), arrowprops={"arrowstyle": "<->", "color": DIMENSION})
        axes.plot([sign * back, sign * back], [80, 115], color=DIMENSION, lw=0.8)
        axes.text((sign * back + datum) / 2, 115, "70 mm", ha="center", color=DIMENSION, fontsize=9.5)
    axes.text(-(back + 73.0), 124, "tread datum", color=DIMENSION, fontsize=9.5, ha="right")
    axes.text(
        -262, -88, "profile axes: y to the field side, z down; wheel origin at the datum", color=DIMENSION, fontsize=9.5
    )


def _top_view(axes: Axes) -> None:
    """Draw the wheelset from above, forward to the right: +y points up the page."""
    s = np.linspace(0.0, 10.0, 300)
    centre = 0.22 * np.sin(0.75 * s - 1.2)
    axes.plot([0, 10], [0, 0], ":", color=DIMENSION, lw=1.0)
    axes.plot(s, centre, "-.", color=DIMENSION, lw=1.0)
    for offset in (0.85, -0.85):
        axes.plot(s, centre + offset, color=INK, lw=2.2)
    middle, yaw = np.array([4.2, 0.33]), 0.16
    along, across = np.array([math.cos(yaw), math.sin(yaw)]), np.array([-math.sin(yaw), math.cos(yaw)])
    axes.plot(*np.array([middle - 0.98 * across, middle + 0.98 * across]).T, color="#8996a3", lw=5, zorder=2)
    for side, colour, name in ((0.78, LEFT, "L"), (-0.78, RIGHT, "R")):
        corner = middle + side * across
        shape = [corner + a * along + b * across for a, b in ((-0.5, -0.07), (0.5, -0.07), (0.5, 0.07), (-0.5, 0.07))]
        axes.add_patch(Polygon(shape, closed=True, facecolor=STEEL, edgecolor=colour, lw=1.6, zorder=3))
        axes.text(*(corner - 0.66 * along), name, color=colour, ha="right", va="center", fontsize=12)
    axes.plot([middle[0], middle[0] + 2.3], [middle[1], middle[1]], ":", color=INK, lw=1.0)
    axes.plot(*np.array([middle, middle + 2.3 * along]).T, "--", color=INK, lw=1.0)
    arc = FancyArrowPatch(
        (6.2, middle[1]), (6.17, middle[1] + 0.32), connectionstyle="arc3,rad=0.2", arrowstyle="-|>", mutation_scale=12
    )
    axes.add_patch(arc)
    axes.text(6.62, 0.48, r"$\psi>0$ turns the front to the left", fontsize=11)
    for x, high, label in ((3.2, 0.22 * math.sin(0.75 * 3.2 - 1.2), "$d$"), (4.2, 0.33, "$y$")):
        axes.annotate("", (x, high), (x, 0.0), arrowprops={"arrowstyle": "->", "color": INK, "lw": 1.3}, zorder=6)
        axes.text(x + 0.1, high / 2, label, fontsize=12, va="center", zorder=7)
    for end, label, spot in (((1.5, -1.9), "+x (forward)", (1.55, -1.95)), ((0.3, -1.3), "+y (left)", (0.38, -1.45))):
        axes.add_patch(FancyArrowPatch((0.3, -1.9), end, arrowstyle="-|>", mutation_scale=15, color=INK, lw=1.8))
        axes.text(*spot, label, fontsize=11)
    axes.text(6.3, -0.42, "track centre line, lateral alignment $d$", color=DIMENSION, fontsize=9.5)
    axes.text(5.0, -1.75, "lateral displacement of the wheelset on the track: $y-d$, positive to the left", fontsize=11)
    axes.set_title("Top view", fontsize=12)
    axes.set_xlim(0, 10.2)
    axes.set_ylim(-2.05, 1.5)
    axes.set_aspect("equal")
    axes.axis("off")


if __name__ == "__main__":
    main()
