"""From the axes of a file to those of a profile: z down, y to the field side, in order along the profile.

What a file leaves open (SIMPACK leaves the gauge side and the origin of y) is decided from the shape:

- z is turned over if the point that must lie inside the profile (the crown of a rail, the tip of a flange) comes out
  in the first or last tenth (rails) or twentieth (wheels) of the points, or if a rail is flatter the other way up
  (what looks like a crown is the groove beside a guard rail).
- A wheel's flange is brought to the side of negative y. If its tip is then within 25 mm of zero, zero is the flange
  back and y is moved to the tread datum; ``origin`` fixes what zero is. Zero of z is the tread at the datum.
- A rail is turned until its gauge side is negative, as below. Zero of z is the crown; y
  stays, because a rail is placed in the track by its gauge.

Which side of a rail is its gauge side, from the shape of the head.

- Only one side reaches 14 mm below the crown, or neither does and one ends 3 mm deeper: the gauge is measured there.
- Both reach deep enough and the head leans: a rail leans towards the track centre, so the middle between its sides
  moves to the field side with depth. Below 14.5 mm no wheel wears a side.
- The two sides are alike to 0.05 mm: either will do.
- Else the shape does not show it, because wear of one side and inclination look alike.
"""

from __future__ import annotations

import numpy as np

from estimation.contact.parameters import PROFILES
from estimation.contact.penalised_spline import rough_noise
from estimation.contact.profiles import Profile, ProfileKind
from estimation.contact.smoothed_profile import SmoothedProfile, advancing, smoothed_profile, thinned, without_spikes
from estimation.errors import ProfileError
from estimation.values.arrays import FloatArray, IntArray
from estimation.values.units import MILLIMETRE
from ingest.profiles.points import FilePoints, Origin

_GAUGE_DEPTH = PROFILES.gauge_depth * 1e3  # mm
_DEPTHS = np.arange(14.5, 30.1, 0.5)  # mm below the crown, where sides are straight and not worn
_FEWEST_DEPTHS = 9
LEAST_LEAN = 0.012  # tangent from which a head counts as leaning; rails are inclined by 1:40 to 1:20
_MOST_LEAN = 0.07
_MOST_DIVERGENCE = 0.15  # of the sides, whose own slopes are 1:20 at most; a worn gauge face exceeds it
_ALIKE = 0.05  # mm, root mean square
_MEASURED_DEEPER = 3.0  # mm, by which the side is followed deeper that matters to who measured it


def gauge_side_is_positive(y: FloatArray, depth: FloatArray) -> bool | None:
    """Return whether the gauge side of a rail is at positive y; None if its shape does not show it.

    The points (n,), mm, are in order of the profile with y increasing on the whole, their depth below the crown.
    """
    crown = int(np.argmin(depth))
    deepest = [float(part.max()) for part in (depth[: crown + 1], depth[crown:])]
    reaches = [side >= _GAUGE_DEPTH for side in deepest]
    if reaches[0] != reaches[1] or (not reaches[0] and abs(deepest[1] - deepest[0]) > _MEASURED_DEEPER):
        return deepest[1] > deepest[0]
    leaning = lean(y, depth)
    if LEAST_LEAN <= abs(leaning) <= _MOST_LEAN:
        return leaning < 0.0
    if _sides_alike(y, depth, min(_GAUGE_DEPTH, *deepest)):
        return False
    return None


def lean(y: FloatArray, depth: FloatArray) -> float:
    """Return the tangent by which the head leans towards negative y, from its sides; NaN if these are short or worn."""
    crown = int(np.argmin(depth))
    left = _side(y[crown::-1], depth[crown::-1])
    right = _side(y[crown:], depth[crown:])
    middle = 0.5 * (left + right)
    usable = np.isfinite(middle)
    if np.count_nonzero(usable) < _FEWEST_DEPTHS:
        return float("nan")
    divergence = float(np.polyfit(_DEPTHS[usable], (right - left)[usable], 1)[0])
    leaning = float(np.polyfit(_DEPTHS[usable], middle[usable], 1)[0])
    return leaning if abs(divergence) <= _MOST_DIVERGENCE else float("nan")


def _side(y: FloatArray, depth: FloatArray) -> FloatArray:
    """Return y at the depths, as the mean of the points around each; NaN below the deepest point of the way down."""
    turn = int(np.argmax(depth))
    y, depth = y[: turn + 1], depth[: turn + 1]
    result = np.full(len(_DEPTHS), np.nan)
    if depth[-1] < _DEPTHS[0]:
        return result
    rising = np.maximum.accumulate(depth)
    inside = depth[-1] >= _DEPTHS
    result[inside] = np.interp(_DEPTHS[inside], rising, y)
    return result


def _sides_alike(y: FloatArray, depth: FloatArray, level: float) -> bool:
    """Return whether the head is the same seen from either of its faces at ``level`` below the crown, mm."""
    crown = int(np.argmin(depth))
    left = float(np.interp(level, np.maximum.accumulate(depth[crown::-1]), y[crown::-1]))
    right = float(np.interp(level, np.maximum.accumulate(depth[crown:]), y[crown:]))
    inwards = np.linspace(2.0, 0.5 * (right - left), 60)
    order = np.argsort(y, kind="stable")
    from_left = np.interp(left + inwards, y[order], depth[order])
    from_right = np.interp(right - inwards, y[order], depth[order])
    return float(np.sqrt(np.mean((from_left - from_right) ** 2))) < _ALIKE


LARGEST_STEP = 0.08  # mm
LEAST_NOISE = 1e-4  # mm
SIGNIFICANT = 6.0  # standard deviations
_REACH = 2.0  # mm to either side that are extrapolated
_FEWEST = 4  # points to either side
_TREAD = (-32.0, 28.0)  # mm from the tread datum: there a wheel has no corner of its own
_HALF_HEAD, _RUNNING_DEPTH = 25.0, 5.0  # mm from the crown: the running surface of a rail
_GENTLE = 0.5  # slope up to which a surface is no flank


def check_steps(y: FloatArray, z: FloatArray, lines: IntArray, kind: ProfileKind) -> None:
    """Raise where tread or crown have a step that no wear makes.

    At each gap between points straight lines through the 2 mm on either side are continued to it; a step is where
    they differ by more than 0.08 mm and by 6 standard deviations, and both are flatter than 1:2. Single points far from
    their neighbours make no step.
    """
    order = np.argsort(y, kind="stable")
    if kind == "wheel":
        running = (y >= _TREAD[0]) & (y <= _TREAD[1])
    else:
        crown = y[order[np.argmin(z[order])]]
        running = (np.abs(y - crown) < _HALF_HEAD) & (z < _RUNNING_DEPTH)
    order = order[running[order]]
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
            line=int(lines[at]),
            field="z",
        )


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


_RAIL_MARGIN = 0.10
_WHEEL_MARGIN = 0.05
_FLANGE_BACK_WITHIN = 25.0  # mm from the tip of the flange
_SAME_POINT = 1e-6  # mm, a row that repeats the one before is left out
_TOP = 1.0  # mm
_WIDER = 1.5  # times: crowns are flatter than grooves
_LARGEST_GAP = 10.0  # mm between neighbours
_MOST_BACKWARDS = 2.0  # times the width: what rows run backwards in all
_LEAST_FLANGE = 15.0  # mm of height
_TIP_WITHIN = (-70.0, -45.0)  # mm from the tread datum
_LEAST_TREAD = 10.0  # mm outside the tread datum
_HEAD_DEPTH = 4.0  # mm below the crown, what is a head
_GROOVE_DEPTH = 15.0  # mm
_METRES_BELOW = 1.0  # mm of width: no profile is so narrow
_NARROWEST = 30.0  # mm, in another unit below
_LARGEST_SPAN = 500.0  # mm, in either direction: wheels are up to 150 mm wide, whole rails 180 mm high
_HEAD_WIDTH = (40.0, 100.0)  # mm
_LEAST_HEAD_DEPTH = 1.0  # mm on either side of the crown


def oriented(
    points: FilePoints,
    kind: ProfileKind,
    name: str,
    *,
    mirror: bool | None = None,
    origin: Origin = Origin.AUTO,
    noise_std: float | None = None,
) -> SmoothedProfile:
    """Return the profile that the points of a file describe, in the axes of :class:`Profile`.

    Args:
        points: Points in mm in the order of the file, and whether the file fixes z.
        mirror: Of a rail: whether its gauge side is at positive y of the file; None decides from the shape.
        noise_std: Known noise of the instrument, mm; 0 takes the points as they are, None estimates it.
    """
    _check_span(points, kind)
    y, z = points.y, points.z if points.axes_known else _upright(points.y, points.z, kind)
    lines = np.array(points.lines)
    apart = np.concatenate([[True], np.hypot(np.diff(y), np.diff(z)) > _SAME_POINT])
    y, z, lines = y[apart], z[apart], lines[apart]
    if y[-1] < y[0]:
        y, z, lines = y[::-1], z[::-1], lines[::-1]
    shown = thinned(np.column_stack([y, z]))
    _check_order(y[shown], z[shown], lines[shown], kind)
    if kind == "wheel":
        y, z, lines = _from_datum(y, z, lines, origin)
    else:
        z = z - z.min()
        _check_groove(y[shown], z[shown])
        _check_head(y, z)
        if _is_mirrored(y, z, points) if mirror is None else mirror:
            y, z, lines = -y[::-1], z[::-1], lines[::-1]
    shown = thinned(np.column_stack([y, z]))
    check_steps(y[shown], z[shown], lines[shown], kind)
    try:
        shape = smoothed_profile(kind, name, np.column_stack([y, z]), noise_std)
    except ProfileError as error:
        raise ProfileError(error.reason, field=error.field or "y") from error
    if kind == "wheel":
        _check_wheel(shape.profile)
    return shape


def _upright(y: FloatArray, z: FloatArray, kind: ProfileKind) -> FloatArray:
    """Return z down: the crown, or the tip of the flange, is inside the profile, and the crown is no groove."""
    peak = int(np.argmin(z) if kind == "rail" else np.argmax(z))
    margin = (_RAIL_MARGIN if kind == "rail" else _WHEEL_MARGIN) * len(z)
    if peak < margin or peak >= len(z) - margin:
        return -z
    return -z if kind == "rail" and _width_at(y, -z) > _WIDER * _width_at(y, z) else z


def _width_at(y: FloatArray, depth: FloatArray) -> float:
    top = depth < depth.min() + _TOP
    return float(np.abs(np.diff(y))[top[:-1] & top[1:]].sum())


def _from_datum(
    y: FloatArray, z: FloatArray, lines: IntArray, origin: Origin
) -> tuple[FloatArray, FloatArray, IntArray]:
    if np.ptp(z) < _LEAST_FLANGE:
        raise ProfileError(
            f"no flange: its tip is expected between {_TIP_WITHIN[0]:.0f} and {_TIP_WITHIN[1]:.0f} mm from the tread "
            f"datum, {_LEAST_FLANGE:.0f} mm high or more; the height of this profile varies by {np.ptp(z):.1f} mm",
            field="z",
        )
    tip = float(y[np.argmax(z)])
    if abs(tip - y[0]) > abs(y[-1] - tip):
        y, z, lines, tip = -y[::-1], z[::-1], lines[::-1], -tip
    from_back = abs(tip) <= _FLANGE_BACK_WITHIN if origin is Origin.AUTO else origin is Origin.FLANGE_BACK
    return (y - PROFILES.tread_datum / MILLIMETRE if from_back else y), z, lines


def _is_mirrored(y: FloatArray, depth: FloatArray, points: FilePoints) -> bool:
    """Return whether the gauge side is positive: as the shape shows it, else as the format has it."""
    shown = gauge_side_is_positive(y, depth)
    if shown is None and not points.axes_known:
        raise ProfileError(
            "both sides reach 14 mm below the crown, they differ, and the head does not lean enough to show which one "
            "is the gauge side; say whether it is at positive y of the file: --mirror or --no-mirror, in a scenario "
            "rail_file_mirror = true or false",
            field="mirror",
        )
    return bool(shown)


def _check_span(points: FilePoints, kind: ProfileKind) -> None:
    """Raise where the numbers are in another unit, or are no profile at all, as those of a track are none."""
    width = float(np.ptp(points.y))
    if width < _METRES_BELOW:
        raise ProfileError(f"spans {width:.3g} mm: the numbers look like metres; give them in mm", field="y")
    if width < _NARROWEST:
        raise ProfileError(
            f"spans {width:.3g} mm, and a {kind} at least {_NARROWEST:.0f} mm: is it in another unit? "
            "Give the whole profile in mm",
            field="y",
        )
    for field, values in (("y", points.y), ("z", points.z)):
        if np.ptp(values) > _LARGEST_SPAN:
            raise ProfileError(
                f"spans {np.ptp(values):.0f} mm, and a {kind} at most {_LARGEST_SPAN:.0f} mm: give a file of the "
                "lateral and the vertical coordinate of one profile, in mm",
                field=field,
            )


def _check_head(y: FloatArray, depth: FloatArray) -> None:
    crown = int(np.argmin(depth))
    shoulders = min(float(depth[: crown + 1].max()), float(depth[crown:].max()))
    width = float(np.ptp(y[depth <= PROFILES.gauge_depth / MILLIMETRE]))
    if not _HEAD_WIDTH[0] <= width <= _HEAD_WIDTH[1] or shoulders < _LEAST_HEAD_DEPTH:
        raise ProfileError(
            f"cannot be a rail head: {width:.1f} mm wide within 14 mm of its crown ({_HEAD_WIDTH[0]:.0f} to "
            f"{_HEAD_WIDTH[1]:.0f} mm are expected), falling by {shoulders:.1f} mm on the shallower side; give a file "
            "of a whole head",
            field="z",
        )


def _check_wheel(wheel: Profile) -> None:
    tip = int(np.argmax(wheel.z))
    at, end = float(wheel.y[tip]) / MILLIMETRE, float(wheel.y[-1]) / MILLIMETRE
    if not _TIP_WITHIN[0] <= at <= _TIP_WITHIN[1] or wheel.z[tip] < _LEAST_FLANGE * MILLIMETRE:
        raise ProfileError(
            f"no flange: its tip is expected between {_TIP_WITHIN[0]:.0f} and {_TIP_WITHIN[1]:.0f} mm from the tread "
            f"datum, {_LEAST_FLANGE:.0f} mm high or more; the lowest point is {wheel.z[tip] / MILLIMETRE:.1f} mm "
            f"below the tread at {at:+.1f} mm",
            field="z",
        )
    if end < _LEAST_TREAD:
        raise ProfileError(
            f"ends {end:+.1f} mm from the tread datum; the tread to {_LEAST_TREAD:+.0f} mm is needed",
            field="y",
        )


def _check_groove(y: FloatArray, depth: FloatArray) -> None:
    kept = advancing(y, int(np.argmin(depth)))
    across, down = y[kept], depth[kept]
    first, last = np.flatnonzero(down < _HEAD_DEPTH)[[0, -1]]
    groove = float(down[first : last + 1].max())
    if groove > _GROOVE_DEPTH:
        raise ProfileError(
            f"two heads with a groove of {groove:.0f} mm between them, at y = {across[first]:.0f} and "
            f"{across[last]:.0f} mm (a guard rail?); give the running rail alone",
            field="y",
        )


def _check_order(y: FloatArray, z: FloatArray, lines: IntArray, kind: ProfileKind) -> None:
    kept = advancing(y, int(np.argmax(z) if kind == "wheel" else np.argmin(z)))
    gap = float(np.diff(y[kept]).max(initial=0.0))
    rows = np.diff(y)
    back = float(-rows[rows < 0.0].sum())
    if back > _MOST_BACKWARDS * np.ptp(y) or gap > _LARGEST_GAP:
        first = np.maximum(lines[1:], lines[:-1])[rows < 0.0].min(initial=lines.max())
        raise ProfileError(
            f"points are not in order along the profile (rows run {back:.0f} mm backwards in all, largest gap "
            f"{gap:.1f} mm); sort them along it, and measure what a gap leaves out",
            line=int(first) if back > 0.0 else int(lines.min()),
            field="y",
        )
