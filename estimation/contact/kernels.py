"""Compiled search for the contact point of one wheel on its rail, and for the roll at which both wheels touch.

Seen from one wheel: lateral is positive to its field side, ``shift`` moves the wheel to its field side relative to the
rail, ``roll`` lifts it. A wheel point at lateral distance p from the middle of the axle and distance d below the axis
is, after the roll, at lateral shift + p cos(roll) + d sin(roll) and depth d cos(roll) - p sin(roll).
The gap is the depth of the rail minus that of the wheel; contact is where the gap is smallest.

All take ``half``, half the distance of the tread datums, m; ``radii``, the nominal ones of the left and right wheel, m;
``wheels`` and ``rails``, left and right surface each: first lateral coordinate and step, m, height (n,), m, slope (n,).
``displacement`` of the axle is from the track centre, m, positive to the left; ``deviation`` is actual
minus nominal gauge, m; both increase strictly where they are (n,) and (g,).
"""

from __future__ import annotations

import math

import numpy as np

from estimation.compiled import compiled
from estimation.contact.parameters import PROFILES

STRIDE = PROFILES.scan_stride
RIVAL_MARGIN = PROFILES.rival_gap
ROLL_TOLERANCE = PROFILES.roll_tolerance
SLOPE_TOLERANCE = PROFILES.slope_tolerance
POSITION_TOLERANCE = PROFILES.position_tolerance
ROLL_LIMIT = PROFILES.roll_limit
JUMP_DISTANCE = PROFILES.jump_distance
JUMP_INTERVAL = PROFILES.jump_interval
CURVE_TOLERANCE = PROFILES.curve_tolerance
CURVE_INTERVAL = PROFILES.curve_interval
OUTSIDE = PROFILES.gap_outside
MOST_HALVINGS = PROFILES.most_halvings

FOUND, NO_OVERLAP, FLANGE_TIP, OUTER_EDGE, NO_ROLL = 0, 1, 2, 3, 4  # outcome of a search: why there is no contact point


@compiled(inline="always")
def _cubic(height, slope, step, position):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202 - compiled
    i = min(max(int(position), 0), len(height) - 2)
    t = position - i
    rise = height[i + 1] - height[i]
    a = slope[i] * step - rise
    b = rise - slope[i + 1] * step
    value = height[i] + t * rise + t * (1.0 - t) * (a * (1.0 - t) + b * t)
    derivative = rise + (1.0 - 2.0 * t) * (a * (1.0 - t) + b * t) + t * (1.0 - t) * (b - a)
    return value, derivative / step


@compiled(inline="always")
def _gap_at(y, shift, cosine, sine, half, radius, wheel, rail):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    z, dz = _cubic(wheel[2], wheel[3], wheel[1], (y - wheel[0]) / wheel[1])
    across, below = half + y, radius + z
    position = shift + across * cosine + below * sine
    depth, rail_slope = _cubic(rail[2], rail[3], rail[1], (position - rail[0]) / rail[1])
    gap = depth - (below * cosine - across * sine)
    return gap, rail_slope * (cosine + dz * sine) - (dz * cosine - sine), position, rail_slope


@compiled()
def _refine(low, high, shift, cosine, sine, half, radius, wheel, rail):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    """Return where between low and high the gap's slope crosses zero upwards (regula falsi, Illinois)."""
    slope_low = _gap_at(low, shift, cosine, sine, half, radius, wheel, rail)[1]
    slope_high = _gap_at(high, shift, cosine, sine, half, radius, wheel, rail)[1]
    if slope_low >= 0.0:
        return low
    if slope_high <= 0.0:
        return high
    side = 0
    for _ in range(60):
        y = (low * slope_high - high * slope_low) / (slope_high - slope_low)
        slope = _gap_at(y, shift, cosine, sine, half, radius, wheel, rail)[1]
        if abs(slope) < SLOPE_TOLERANCE or high - low < POSITION_TOLERANCE:
            return y
        if slope < 0.0:
            low, slope_low = y, slope
            slope_high *= 0.5 if side == -1 else 1.0
            side = -1
        else:
            high, slope_high = y, slope
            slope_low *= 0.5 if side == 1 else 1.0
            side = 1
    return 0.5 * (low + high)


@compiled()
def _scan(gaps, shift, cosine, sine, half, radius, wheel, rail):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    rail_length = len(rail[2]) - 1
    best, first, last = OUTSIDE, -1, -1
    for k in range(len(gaps)):
        i = k * STRIDE
        across, below = half + wheel[0] + i * wheel[1], radius + wheel[2][i]
        position = (shift + across * cosine + below * sine - rail[0]) / rail[1]
        if position < 0.0 or position > rail_length:
            gaps[k] = OUTSIDE
            continue
        j = min(int(position), rail_length - 1)
        depth = rail[2][j] + (position - j) * (rail[2][j + 1] - rail[2][j])
        gaps[k] = depth - (below * cosine - across * sine)
        first = k if first < 0 else first
        last = k
        best = min(best, gaps[k])
    return best, first, last


@compiled()
def nearest(shift, roll, half, radius, wheel, rail):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN201
    """Return gap, wheel coordinate, rail position, d gap / d roll and outcome of the smallest gap of one wheel.

    ``radius`` is its own, ``wheel`` and ``rail`` are one surface each; the outcome is not ``NO_ROLL``.
    """
    cosine, sine = math.cos(roll), math.sin(roll)
    gaps = np.empty((len(wheel[2]) - 1) // STRIDE + 1)
    best, first, last = _scan(gaps, shift, cosine, sine, half, radius, wheel, rail)
    if last - first < 2:  # noqa: PLR2004 - a minimum needs two neighbours
        return OUTSIDE, math.nan, math.nan, 0.0, NO_OVERLAP
    smallest, found, at_edge, span = OUTSIDE, math.nan, 0, STRIDE * wheel[1]
    for k in range(first, last + 1):
        if gaps[k] > best + RIVAL_MARGIN:
            continue
        if (k > first and gaps[k] > gaps[k - 1]) or (k < last and gaps[k] > gaps[k + 1]):
            continue
        low, high = wheel[0] + max(k - 1, first) * span, wheel[0] + min(k + 1, last) * span
        y = _refine(low, high, shift, cosine, sine, half, radius, wheel, rail)
        gap = _gap_at(y, shift, cosine, sine, half, radius, wheel, rail)[0]
        if gap < smallest:
            smallest, found = gap, y
            at_edge = -1 if (k == first and y == low) else (1 if (k == last and y == high) else 0)
    _, _, position, rail_slope = _gap_at(found, shift, cosine, sine, half, radius, wheel, rail)
    z = _cubic(wheel[2], wheel[3], wheel[1], (found - wheel[0]) / wheel[1])[0]
    across = (half + found) * cosine + (radius + z) * sine
    below = (radius + z) * cosine - (half + found) * sine
    outcome = FOUND if at_edge == 0 else (FLANGE_TIP if at_edge < 0 else OUTER_EDGE)
    return smallest, found, position, rail_slope * below + across, outcome


@compiled()
def touching_roll(start, left_shift, right_shift, half, radii, wheels, rails):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN201
    """Return the roll at which both gaps are equal, both contacts, and the outcome: safeguarded Newton-Raphson.

    It begins at roll ``start``. Contacts are (wheel coordinate, rail position) of the left and right wheel.
    """
    roll, low, high = start, -ROLL_LIMIT, ROLL_LIMIT
    left = nearest(left_shift, roll, half, radii[0], wheels[0], rails[0])
    right = nearest(right_shift, -roll, half, radii[1], wheels[1], rails[1])
    for _ in range(80):
        if left[4] == NO_OVERLAP or right[4] == NO_OVERLAP:
            break
        difference = left[0] - right[0]
        if abs(difference) < ROLL_TOLERANCE or high - low < 1e-14:  # noqa: PLR2004 - rad
            outcome = left[4] if left[4] != FOUND else right[4]
            return roll, left[1], right[1], left[2], right[2], outcome
        if difference < 0.0:
            low = roll
        else:
            high = roll
        rate = left[3] + right[3]
        step = difference / rate if rate > 0.0 else math.inf
        roll = roll - step if low < roll - step < high else 0.5 * (low + high)
        left = nearest(left_shift, roll, half, radii[0], wheels[0], rails[0])
        right = nearest(right_shift, -roll, half, radii[1], wheels[1], rails[1])
    return math.nan, math.nan, math.nan, math.nan, math.nan, NO_ROLL


@compiled()
def contact(displacement, deviation, start, rigid, half, radii, wheels, rails):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN201
    """Return roll, wheel coordinates, rail positions (left, right each) and outcome of one position of the wheelset.

    ``rigid``: it rolls, from roll ``start`` on, until both wheels touch; without, each side is on its own (EN 15302).
    """
    left_shift, right_shift = displacement - 0.5 * deviation, -displacement - 0.5 * deviation
    if rigid:
        return touching_roll(start, left_shift, right_shift, half, radii, wheels, rails)
    left = nearest(left_shift, 0.0, half, radii[0], wheels[0], rails[0])
    right = nearest(right_shift, 0.0, half, radii[1], wheels[1], rails[1])
    return 0.0, left[1], right[1], left[2], right[2], left[4] if left[4] != FOUND else right[4]


@compiled()
def table(displacement, deviation, rigid, half, radii, wheels, rails):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN201
    """Return (5, n, g) roll, wheel coordinates, rail positions, and outcomes (n, g): from the centre outwards."""
    n, g = len(displacement), len(deviation)
    values, outcomes = np.full((5, n, g), np.nan), np.zeros((n, g), np.int64)
    centre = int(np.argmin(np.abs(displacement)))
    for j in range(g):
        for direction in (1, -1):
            i = centre if direction == 1 else centre - 1
            roll = 0.0 if direction == 1 else values[0, centre, j]
            while 0 <= i < n:
                start = roll if math.isfinite(roll) else 0.0
                found = contact(displacement[i], deviation[j], start, rigid, half, radii, wheels, rails)
                values[0, i, j], outcomes[i, j] = found[0], found[5]
                values[1, i, j], values[2, i, j] = found[1], found[2]
                values[3, i, j], values[4, i, j] = found[3], found[4]
                roll = found[0]
                i += direction
    return values, outcomes


@compiled()
def _moved(first, second):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    left = max(abs(first[1] - second[1]), abs(first[3] - second[3]))
    right = max(abs(first[2] - second[2]), abs(first[4] - second[4]))
    return max(left, right)


@compiled()
def _is_jump(low, high, first, second, deviation, rigid, half, radii, wheels, rails):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    while _moved(first, second) > JUMP_DISTANCE:
        if high - low < JUMP_INTERVAL:
            return True
        middle = 0.5 * (low + high)
        between = contact(middle, deviation, first[0], rigid, half, radii, wheels, rails)
        if between[5] != FOUND:
            return False
        if _moved(first, between) > _moved(between, second):
            high, second = middle, between
        else:
            low, first = middle, between
    return False


@compiled()
def jumps(displacement, deviation, values, outcomes, rigid, half, radii, wheels, rails):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN201
    """Return (n - 1, g): whether a contact jumps between a displacement and the next, by what :func:`table` has."""
    n, g = outcomes.shape
    crossed = np.zeros((max(n - 1, 0), g), np.bool_)
    for j in range(g):
        for i in range(n - 1):
            if outcomes[i, j] != FOUND or outcomes[i + 1, j] != FOUND:
                continue
            v, w = values[:, i, j], values[:, i + 1, j]
            first = (v[0], v[1], v[2], v[3], v[4], FOUND)
            second = (w[0], w[1], w[2], w[3], w[4], FOUND)
            low, high = displacement[i], displacement[i + 1]
            crossed[i, j] = _is_jump(low, high, first, second, deviation[j], rigid, half, radii, wheels, rails)
    return crossed


@compiled()
def _difference(found, wheels):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN202
    left, right = wheels
    z_left = _cubic(left[2], left[3], left[1], (found[1] - left[0]) / left[1])[0]
    return z_left - _cubic(right[2], right[3], right[1], (found[2] - right[0]) / right[1])[0]


@compiled()
def refined(displacement, deviation, values, outcomes, rigid, half, radii, wheels, rails):  # type: ignore[no-untyped-def]  # noqa: ANN001, ANN201
    """Return (m,) displacements and (2, m) contacts on the wheels between which the radius difference is straight.

    Cells of the grid are halved where a contact moves by more than `JUMP_DISTANCE` or where the difference half-way
    is off the straight line by more than `CURVE_TOLERANCE`, down to `CURVE_INTERVAL`: a jump is between two points
    that are no farther apart than that. A cell without contact in its middle is left as it is. Values (5, n) and
    outcomes (n,) are those of one gauge.
    """
    points = [(math.nan, math.nan, math.nan) for _ in range(0)]
    upper = [(0.0, (math.nan, math.nan, math.nan, math.nan, math.nan, FOUND)) for _ in range(0)]
    for i in range(len(displacement)):
        if outcomes[i] != FOUND:
            continue
        v = values[:, i]
        low, first = displacement[i], (v[0], v[1], v[2], v[3], v[4], FOUND)
        points.append((low, first[1], first[2]))
        if i + 1 == len(displacement) or outcomes[i + 1] != FOUND:
            continue
        w = values[:, i + 1]
        upper.append((displacement[i + 1], (w[0], w[1], w[2], w[3], w[4], FOUND)))
        while len(upper) > 0:
            high, second = upper[-1]
            if high - low > CURVE_INTERVAL and len(upper) < MOST_HALVINGS:
                middle = 0.5 * (low + high)
                between = contact(middle, deviation, first[0], rigid, half, radii, wheels, rails)
                chord = 0.5 * (_difference(first, wheels) + _difference(second, wheels))
                bent = _moved(first, second) > JUMP_DISTANCE or (
                    abs(_difference(between, wheels) - chord) > CURVE_TOLERANCE
                )
                if between[5] == FOUND and bent:
                    upper.append((middle, between))
                    continue
            upper.pop()
            low, first = high, second
            if len(upper) > 0:
                points.append((low, first[1], first[2]))
    found = np.empty((3, len(points)))
    for i in range(len(points)):
        found[0, i], found[1, i], found[2, i] = points[i]
    return found[0], found[1:]
