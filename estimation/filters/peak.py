"""Where between its samples a sampled score is largest."""

from __future__ import annotations

from estimation.values.arrays import FloatArray


def peak_position(score: FloatArray, k: int) -> float:
    """Return the position, in samples, of the vertex of the parabola through a peak and its neighbours.

    Args:
        score: (n,) at equal distances.
        k: Of the largest one; itself is returned at an end, and where the three do not bend downwards.
    """
    if not 0 < k < len(score) - 1:
        return float(k)
    before, at, after = score[k - 1 : k + 2]
    bend = before - 2.0 * at + after
    return float(k + (0.5 * (before - after) / bend if bend < 0.0 else 0.0))
