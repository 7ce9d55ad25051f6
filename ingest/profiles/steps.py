"""Steps in a measured profile: places where the instrument moved, or two measurements were joined."""

from __future__ import annotations

import numpy as np

from estimation.contact.penalised_spline import rough_noise
from estimation.contact.profiles import ProfileKind
from estimation.contact.smoothed_profile import without_spikes
from estimation.errors import ProfileError
from estimation.values.arrays import FloatArray, IntArray

LARGEST_STEP = 0.08  # mm
LEAST_NOISE = 1e-4  # mm
SIGNIFICANT = 6.0  # standard deviations
_REACH = 2.0  # mm to either side that are extrapolated
_FEWEST = 4  # points to either side
_TREAD = (-32.0, 28.0)  # mm from the tread datum: there a wheel has no corner of its own
_GENTLE = 0.5  # slope up to which a surface is no flank


def check_steps(y: FloatArray, z: FloatArray, lines: IntArray, kind: ProfileKind, file: str) -> None:
    """Raise where tread or crown have a step that no wear makes.

    At each gap between points straight lines through the 2 mm on either side are continued to it; a step is where
    they differ by more than 0.08 mm and by 6 standard deviations, and both are flatter than 1:2. Single points far from
    their neighbours make no step.

    Args:
        y, z: (n,) mm, in the axes of the profile, y increasing on the whole.
        lines: (n,) of the file.
        kind: ``"wheel"`` or ``"rail"``.

    Raises:
        ProfileError: There is a step; the message names its line and size.
    """
    order = np.argsort(y, kind="stable")
    order = order[_where(y[order], z[order], kind)]
    if len(order) <= 2 * _FEWEST:
        return
    points = np.column_stack([y[order], z[order]])
    noise = max(rough_noise(points), LEAST_NOISE)
    order = order[without_spikes(points, noise) > 0.0]
    y, z, lines = y[order], z[order], lines[order]
    worst, at = 0.0, 0
    for index in range(_FEWEST, len(y) - _FEWEST):
        gap = 0.5 * (y[index - 1] + y[index])
        before = _continued(y[:index], z[:index], gap)
        after = _continued(y[index:], z[index:], gap)
        gentle = max(abs(before[1]), abs(after[1])) < _GENTLE
        step, error = abs(before[0] - after[0]), SIGNIFICANT * noise * float(np.hypot(before[2], after[2]))
        if gentle and step > max(LARGEST_STEP, error) and step > worst:
            worst, at = step, index
    if worst:
        raise ProfileError(
            f"a step of {worst:.2f} mm at y = {y[at]:.1f} mm: the instrument moved or two measurements were joined; "
            "measure again, or leave out one side of it",
            file=file,
            line=int(lines[at]),
            field="z",
        )


def _where(y: FloatArray, z: FloatArray, kind: ProfileKind) -> IntArray:
    if kind == "wheel":
        return np.flatnonzero((y >= _TREAD[0]) & (y <= _TREAD[1]))
    crown = float(y[np.argmin(z)])
    return np.flatnonzero((np.abs(y - crown) < 25.0) & (z < 5.0))  # noqa: PLR2004 - mm, the running surface


def _continued(y: FloatArray, z: FloatArray, at: float) -> tuple[float, float, float]:
    """Return the line through the points near ``at`` continued to it, its slope, and its std for unit noise."""
    near = np.flatnonzero(np.abs(y - at) <= _REACH)
    if len(near) < _FEWEST:
        return float("nan"), 0.0, 0.0
    offset = y[near] - at
    design = np.column_stack([np.ones(len(near)), offset])
    inverse = np.linalg.pinv(design.T @ design)
    value, slope = inverse @ design.T @ z[near]
    return float(value), float(slope), float(np.sqrt(inverse[0, 0]))
