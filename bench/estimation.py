"""How near the estimates come: ideal sensors on the paper's pair; MEMS sensors: ``section``."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from api import reproduction
from bench.report import BenchRow, row_bench
from estimation.values.geometry import COMBINATIONS, BinStatus

SECONDS = 600.0
SEEDS = (1, 2, 3)
LEAST_SAMPLES = 2000
LIMITS = {
    "rolling_radius_sum": (0.02e-3, "0.02 mm"),
    "rolling_radius_difference": (0.005, "0.5 % of range"),
    "contact_angle_difference": (0.01, "1 %"),
    "contact_angle_sum": (0.02, "2 %"),
}


def rows() -> Iterator[BenchRow]:
    """Yield the accuracy rows."""
    cases = [reproduction.run(0.0, SECONDS, seed) for seed in SEEDS]
    scores = [score(case) for case in cases]
    for name, (limit, text) in LIMITS.items():
        worst = max(s.errors[name] for s in scores)
        shown = f"{1e3 * worst:.4f} mm" if name == "rolling_radius_sum" else f"{100 * worst:.3f} %"
        yield BenchRow(
            f"ideal sensors, constant gauge, worst bin of {len(SEEDS)} seeds: {name}", shown, text, worst <= limit
        )
    crossed, found, published = (sum(getattr(s, n) for s in scores) for n in ("crossed", "recognised", "published"))
    yield BenchRow(
        "bins that a contact jump crosses",
        f"{found} of {crossed} recognised, {published} published",
        "all recognised, none published",
        found == crossed and published == 0,
    )
    yield from gauge_rows()


@dataclass(frozen=True, slots=True)
class Score:
    """Worst error by combination over the bins that count, and what became of the bins a jump crosses."""

    errors: dict[str, float]
    crossed: int
    recognised: int
    published: int


def score(case: reproduction.Case) -> Score:
    """Compare one case with its truth; differences relative to the range of the truth, sums absolute or relative."""
    enough = case.estimate.samples >= LEAST_SAMPLES
    crossed = enough & (case.jump > 0)
    smooth = enough & ~crossed
    errors = {}
    for name in COMBINATIONS:
        truth, value = case.truth[name][smooth], getattr(case.estimate, name).value[smooth]
        error = float(np.abs(np.where(np.isnan(value), np.inf, value) - truth).max())
        scale = {
            "rolling_radius_sum": 1.0,
            "contact_angle_sum": float(np.abs(truth).min()),
        }.get(name, float(truth.max() - truth.min()))
        errors[name] = error / scale
    jumps, published = np.zeros((2, len(COMBINATIONS), len(enough)), dtype=np.bool_)
    for n, name in enumerate(COMBINATIONS):
        combination = getattr(case.estimate, name)
        jumps[n] = [status is BinStatus.CONTACT_JUMP for status in combination.status]
        published[n] = np.isfinite(combination.value)
    return Score(
        errors,
        int(crossed.sum()),
        int(jumps[:, crossed].all(axis=0).sum()),
        int(published[:, crossed].any(axis=0).sum()),
    )


def gauge_rows() -> Iterator[BenchRow]:
    """Show what becomes of the contact angle sum when the gauge varies unknown to the estimator."""
    case = reproduction.run(reproduction.STANDARD_DEVIATION, SECONDS, SEEDS[0])
    status = case.estimate.contact_angle_sum.status
    enough = case.estimate.samples >= LEAST_SAMPLES
    published = sum(s is BinStatus.ESTIMATED for s, e in zip(status, enough, strict=True) if e)
    centre = case.estimate.bin_centres
    nearest = [int(np.argmin(np.abs(case.printed.centre - c))) for c in centre[enough]]
    printed = case.printed.contact_angle_sum[nearest]
    truth = case.truth["contact_angle_sum"][enough]
    yield BenchRow(
        "gauge varying by 2 mm, unknown: contact angle sum",
        f"{published} of {int(enough.sum())} bins published (the rest are unobservable, or crossed by a jump)"
        f"; the paper's algorithm is off by {np.nanmedian(np.abs(printed / truth - 1)):.0f} times the truth",
        "shown",
        met=True,
    )


main = row_bench("estimation", "Accuracy on known track", __doc__, lambda _options, _folder: rows()).run
