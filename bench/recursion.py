"""Binned least squares against padasip's recursive filter, sample by sample, on the same data."""

from __future__ import annotations

import time
from collections.abc import Iterator

import numpy as np
import padasip

from bench.moments import collect
from bench.report import BenchRow
from estimation.tables.bin_table import solve

SAMPLES = 1_000_000
BINS = 32
RUNS = 5


def rows() -> Iterator[BenchRow]:
    """Compare speed and answer on one million samples in 32 bins, four regressors."""
    rng = np.random.default_rng(1)
    features = rng.standard_normal((SAMPLES, 4))
    index = rng.integers(0, BINS, SAMPLES)
    theta = rng.standard_normal((BINS, 4))
    target = (features * theta[index]).sum(axis=1) + 0.1 * rng.standard_normal(SAMPLES)
    collect(features[:10], target[:10, None], index[:10], BINS)  # compile
    ours, answer = [], np.empty((BINS, 4))
    for _ in range(RUNS):
        began = time.perf_counter()
        moments = collect(features, target[:, None], index, BINS)
        answer = solve(moments.packed, moments.weight, 4, 1).theta[:, :, 0]
        ours.append(time.perf_counter() - began)
    began = time.perf_counter()
    other = np.empty((BINS, 4))
    for b in range(BINS):
        rls = padasip.filters.FilterRLS(n=4, mu=1.0, eps=1e-7, w="zeros")
        rls.run(target[index == b], features[index == b])
        other[b] = rls.w
    theirs = time.perf_counter() - began
    ratio = theirs / float(np.median(ours))
    difference = float(np.abs(answer / other - 1).max())
    yield BenchRow(
        "binned least squares against padasip's RLS filter, 1 M samples",
        f"{ratio:,.0f} times faster ({SAMPLES / np.median(ours) / 1e6:.0f} M against {SAMPLES / theirs / 1e6:.2f} M "
        f"samples/s), largest relative difference {difference:.1e}",
        ">= 100 times, same answer",
        ratio >= 100 and difference < 1e-6,
    )
