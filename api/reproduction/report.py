"""The study as numbers: JSON for programs, a table per bin for people."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from api.reproduction.figures import LEAST_SAMPLES, SCALE
from api.reproduction.study import GAUGE, INCLINATION, SPEED, STANDARD_DEVIATION, WEAR_DEPTH, Case
from estimation.contact.geometry import ContactTable
from estimation.values.arrays import FloatArray
from estimation.values.fields import JsonValue
from estimation.values.geometry import COMBINATIONS

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
    """Return a Markdown page of a figure, bin by bin.

    Args:
        case: The run behind the figure.
    """
    return f"# {title}\n\nWritten by `treadwatch reproduce`.\n\n{table(case)}"


def table(case: Case) -> str:
    """Return a Markdown table, estimate against truth per bin with enough samples."""
    head = ["y-d (mm)", "samples"]
    for name in COMBINATIONS:
        head += [f"{SYMBOLS[name]} true", "bins", "paper"]
    lines = ["| " + " | ".join(head) + " |", "|" + " ---: |" * len(head)]
    centre = _centre(case)
    lines += [
        "| " + " | ".join([f"{1e3 * centre[b]:.2f}", f"{case.estimate.samples[b]:.0f}", *_cells(case, b)]) + " |"
        for b in np.flatnonzero(case.estimate.samples > LEAST_SAMPLES).tolist()
    ]
    return "\n".join(lines) + "\n"


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
        "lateral_displacement_mm": _list(1e3 * _centre(case)),
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
    """Return the spread of rL + rR met in each bin when the gauge varies."""
    edges = case.estimate.bin_edges
    total = case.motion.rolling_radius_left + case.motion.rolling_radius_right
    index = np.digitize(case.motion.relative_displacement, edges) - 1
    met = [total[index == b] for b in range(len(edges) - 1)]
    quantiles = np.array([np.quantile(m, (0.05, 0.5, 0.95)) if len(m) else (np.nan,) * 3 for m in met])
    return {
        "lateral_displacement_mm": _list(1e3 * _centre(case)),
        **{
            f"rolling_radius_sum_{name}_mm": _list(1e3 * column)
            for name, column in zip(("p05", "p50", "p95"), quantiles.T, strict=True)
        },
    }


def _centre(case: Case) -> FloatArray:
    return case.estimate.bin_centres


def _printed_at(case: Case) -> dict[str, FloatArray]:
    """Return the paper's estimates at the bins of ours (the same width, both centred on zero)."""
    width = case.estimate.bin_edges[1] - case.estimate.bin_edges[0]
    place = np.rint((_centre(case) - case.printed.centre[0]) / width).astype(np.int64)
    inside = (place >= 0) & (place < len(case.printed.centre))
    at = np.where(inside, place, 0)
    return {name: np.where(inside, getattr(case.printed, name)[at], np.nan) for name in COMBINATIONS}


def _list(values: FloatArray) -> list[JsonValue]:
    return [float(f"{value:.9g}") if np.isfinite(value) else None for value in values]
