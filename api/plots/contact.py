"""The contact geometry of one wheelset as a picture."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from estimation.alerts.rules.conicity_limit import ANY_CLASS, ConicityLimitRule
from estimation.contact.geometry import ContactTable, WheelsetOnTrack
from estimation.trend.extrapolation import LIMIT_AMPLITUDE
from estimation.values.arrays import FloatArray


@dataclass(frozen=True, slots=True)
class ContactSummary:
    """Wheel, rail, gauge, and the equivalent conicity at 3 mm beside the shipped limit.

    Args:
        inclination: Of the rails, as it was written.
        conicity, std: Equivalent conicity at 3 mm and its standard deviation; None where the contact gives none.
        limit: Of the equivalent conicity at 3 mm, by the shipped rules, which the operator confirms; None where there
            is none.
    """

    wheel_left: str
    wheel_right: str
    rail: str
    inclination: str
    gauge_mm: float
    method: str
    conicity: float | None
    std: float | None
    speed_km_h: float
    limit: float | None

    @property
    def title(self) -> str:
        """Return it in one line."""
        wheels = self.wheel_left if self.wheel_left == self.wheel_right else f"{self.wheel_left} / {self.wheel_right}"
        return f"{wheels} on {self.rail} {self.inclination}, gauge {self.gauge_mm:g} mm, {self.method}"

    @property
    def verdict(self) -> str:
        """Return the conicity at 3 mm beside the limit."""
        value = "unknown" if self.conicity is None else f"{self.conicity:.3f}"
        if self.limit is None:
            return f"at 3 mm: {value}; no limit at {self.speed_km_h:g} km/h"
        return f"at 3 mm: {value}; limit {self.limit:.3f} at {self.speed_km_h:g} km/h"

    def columns(self) -> dict[str, str | float | None]:
        """Return it as columns that are the same in every row of a table."""
        return {
            "wheel_left": self.wheel_left,
            "wheel_right": self.wheel_right,
            "rail": self.rail,
            "inclination": self.inclination,
            "gauge_mm": self.gauge_mm,
            "method": self.method,
            "equivalent_conicity_at_3_mm_1": self.conicity,
            "equivalent_conicity_at_3_mm_std_1": self.std,
            "limit_1": self.limit,
            "limit_speed_km_h": self.speed_km_h,
        }


def contact_summary(
    wheelset: WheelsetOnTrack,
    inclination: str,
    method: str,
    at_limit_amplitude: tuple[float | None, float | None],
    speed_km_h: float,
) -> ContactSummary:
    """Return what a contact geometry is of.

    Args:
        inclination: Of the rails, as it was written.
        at_limit_amplitude: Equivalent conicity at 3 mm and its standard deviation; None where the contact gives none.
    """
    return ContactSummary(
        wheel_left=wheelset.left_wheel.name,
        wheel_right=wheelset.right_wheel.name,
        rail=wheelset.left_rail.name,
        inclination=inclination,
        gauge_mm=round(wheelset.gauge * 1e3, 6),
        method=method,
        conicity=at_limit_amplitude[0],
        std=at_limit_amplitude[1],
        speed_km_h=speed_km_h,
        limit=ConicityLimitRule().limit_at(ANY_CLASS, speed_km_h),
    )


AMPLITUDE_MM = LIMIT_AMPLITUDE * 1e3


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
