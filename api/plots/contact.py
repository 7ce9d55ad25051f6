"""The contact geometry of one wheelset as a picture."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from api.plots.contact_summary import AMPLITUDE_MM, ContactSummary
from estimation.contact.geometry import ContactTable
from estimation.values.arrays import FloatArray

INTERVAL = 1.96  # standard deviations
_LEFT, _RIGHT, _BOTH, _LIMIT = "#1f5fa8", "#c4561a", "#222222", "#b00020"


def save_contact_figure(
    table: ContactTable,
    amplitude: FloatArray,
    conicity: FloatArray,
    std: FloatArray,
    summary: ContactSummary,
    out: Path,
) -> None:
    """Write radii, contact angles, contact positions and equivalent conicity of the table's first gauge as PNG.

    Args:
        table: Contact geometry; the column of its first gauge deviation is drawn.
        amplitude, conicity, std: (k,) m, tan(gamma_e) and its standard deviation, which is drawn where it is not 0.
        summary: What it is, with the conicity at 3 mm and the limit, which are marked.
    """
    figure = Figure(figsize=(10.0, 7.5), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(2, 2)
    y = table.lateral_displacement * 1e3
    _curves(axes[0, 0], y, [("left - right", table.rolling_radius_difference[:, 0] * 1e3, _BOTH)])
    axes[0, 0].set_ylabel("rolling radius difference, mm")
    sides = (("left", _LEFT), ("right", _RIGHT))
    angles = [(name, np.degrees(getattr(table, f"contact_angle_{name}")[:, 0]), colour) for name, colour in sides]
    _curves(axes[0, 1], y, angles)
    axes[0, 1].set_ylabel("contact angle, degrees")
    places = [(name, getattr(table, f"contact_position_{name}")[:, 0] * 1e3, colour) for name, colour in sides]
    _curves(axes[1, 0], y, places)
    axes[1, 0].set_ylabel("contact on the wheel from its tread datum, mm")
    for panel in (axes[0, 0], axes[0, 1], axes[1, 0]):
        panel.set_xlabel("lateral displacement (left positive), mm")
        panel.legend(frameon=False)
    axes[1, 1].plot(amplitude * 1e3, conicity, color=_BOTH, marker="o", markersize=3)
    if np.nan_to_num(std).any():
        low, high = conicity - INTERVAL * std, conicity + INTERVAL * std
        label = "95 % interval"
        axes[1, 1].fill_between(amplitude * 1e3, low, high, color=_BOTH, alpha=0.2, linewidth=0.0, label=label)
    if summary.limit is not None:
        label = f"limit {summary.limit:.3f} at {summary.speed_km_h:g} km/h"
        axes[1, 1].axhline(summary.limit, color=_LIMIT, linestyle="--", linewidth=1.2, label=label)
    if summary.conicity is not None:
        label = f"{summary.conicity:.3f} at 3 mm"
        axes[1, 1].plot([AMPLITUDE_MM], [summary.conicity], "o", color=_RIGHT, markersize=7, label=label)
    axes[1, 1].legend(frameon=False)
    axes[1, 1].set_xlabel("amplitude, mm")
    axes[1, 1].set_ylabel("equivalent conicity tan γₑ")
    axes[1, 1].set_ylim(bottom=0.0)
    axes[1, 1].grid(visible=True, color="#dddddd")
    figure.suptitle(f"{summary.title}\nequivalent conicity {summary.verdict}")
    figure.savefig(out, format="png", dpi=110)


def _curves(panel: Axes, y: FloatArray, curves: list[tuple[str, FloatArray, str]]) -> None:
    for name, values, colour in curves:
        panel.plot(y, values, label=name, color=colour, linewidth=1.4)
    panel.grid(visible=True, color="#dddddd")
    panel.margins(x=0.0)
