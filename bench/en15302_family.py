"""The conicity of EN 15302 of many worn wheelsets by contact tables alone, with and without what R says of the roll.

Wheels are those of the worn family: standard wheels on standard rails, hollow by formula or worn by their contact. The
constants of ``geometry.contact_roll`` were chosen on every other pair of it; these are the pairs between.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice

import numpy as np

from bench.report import BenchRow
from bench.worn_family import PAIRS, USUAL_CONICITY, wheelsets
from estimation.contact.conicity import equivalent_conicity
from estimation.contact.geometry import WheelsetOnTrack, contact_table, radius_difference_curve, refined_curve
from estimation.errors import ContactError
from estimation.geometry.conicity import CurveParameters, CurveReplicates, curve_estimates
from estimation.geometry.sharpening import ContactRoll
from estimation.geometry.uncertainty import SCALE_STDS, DisplacementError
from estimation.motion.integration import standard_displacement
from estimation.tables.bin_table import BinParameters
from estimation.values.arrays import FloatArray

AMPLITUDES = (2.0e-3, 2.5e-3, 3.0e-3)
GRID = 0.01e-3 * np.arange(-700, 701)  # m
REACH = 3.7e-3  # m, of the bins
EVERY = 4  # wheelset of a pair
GROUPS = 4
IN_BIN = 25  # places
COVERED = 0.92  # share that the 95 % intervals are to hold
NAMES = {ContactRoll.SEEN: "level track", ContactRoll.HIDDEN: "track that may roll"}


def rows() -> Iterator[BenchRow]:
    """Yield a row for level track and one for track that may roll."""
    of_all = list(_wheelsets())
    for roll in ContactRoll:
        yield _row(roll, of_all)


def _wheelsets() -> Iterator[WheelsetOnTrack]:
    for pair in PAIRS[1::2]:
        for (left, right), rail in islice(wheelsets(pair), 0, None, EVERY):
            yield WheelsetOnTrack(left, right, rail, rail, 1.0 / pair.inclination, 1.435)


def _row(roll: ContactRoll, of_all: list[WheelsetOnTrack]) -> BenchRow:
    errors = [of_wheelset for wheelset in of_all if (of_wheelset := _errors(wheelset, roll)) is not None]
    error = np.array(errors)  # (w, 2, 3, 2): without and with, amplitude, error and half width
    rms = np.sqrt(np.mean(error[..., 0] ** 2, axis=0))
    inside = np.mean(np.abs(error[..., 0]) <= error[..., 1], axis=0)
    width = np.median(error[..., 1], axis=0)
    said = "; ".join(
        f"{name} rms of the error {_text(rms[k])}, half width {_text(width[k])} (median), holds {_percent(inside[k])} %"
        for k, name in enumerate(("without what R says", "with it"))
    )
    return BenchRow(
        f"{len(errors)} worn wheelsets of pairs not used for constants, {NAMES[roll]}, 2 / 2.5 / 3 mm",
        said,
        "smaller error; intervals hold 92 %",
        bool((rms[1] < rms[0]).all() and (inside[1] >= COVERED).all()),
    )


def _errors(wheelset: WheelsetOnTrack, roll: ContactRoll) -> FloatArray | None:
    """Return (2, 3, 2) without and with what R says, by amplitude, error and half width; None for no usual wheelset."""
    try:
        table, standard = contact_table(wheelset, GRID, outside="hold"), radius_difference_curve(wheelset, GRID[::10])
        ran = refined_curve(wheelset, table, 0)
    except ContactError:
        return None
    true = equivalent_conicity(standard.displacement, standard.difference, AMPLITUDES)
    low, high = USUAL_CONICITY
    if not (np.isfinite(true).all() and low <= true[-1] <= high):
        return None
    phi = np.interp(ran.displacement, GRID, table.roll[:, 0])
    x = standard_displacement(ran.displacement, phi, wheelset.left_radius, level=roll is ContactRoll.HIDDEN)
    curves = [_curve(x, ran.difference, roll, said) for said in (None, roll)]
    estimates = [curve_estimates(curve, CurveParameters(amplitudes=AMPLITUDES)).conicity for curve in curves]
    values = np.array([[(e.value, e.high) for e in conicities] for conicities in estimates], dtype=np.float64)
    errors = np.stack([values[..., 0] - true, values[..., 1] - values[..., 0]], axis=-1)
    return errors if np.isfinite(errors).all() else None


def _curve(x: FloatArray, difference: FloatArray, roll: ContactRoll, said: ContactRoll | None) -> CurveReplicates:
    """Return R in bins, without noise, as a quadratic in each."""
    edges = BinParameters(reach=REACH).edges
    u = (np.arange(IN_BIN) + 0.5) / IN_BIN - 0.5
    at = 0.5 * (edges[:-1] + edges[1:])[:, None] + (edges[1] - edges[0]) * u
    further = np.maximum.accumulate(x)
    rises = np.append(True, np.diff(further) > 0.0)
    values = np.interp(at, further[rises], difference[rises])
    shape = values @ np.linalg.pinv(np.vander(u, 3, increasing=True)).T
    return CurveReplicates(
        edges,
        np.repeat(shape[None], 1 + GROUPS, axis=0),
        np.zeros((len(shape), 0, 3)),
        np.ones(len(shape), dtype=np.bool_),
        DisplacementError(0.0, 0.0, SCALE_STDS[roll]),
        1.0,
        band_limited=False,
        contact_roll=said,
    )


def _text(values: FloatArray) -> str:
    return " / ".join(f"{value:.4f}" for value in values)


def _percent(shares: FloatArray) -> str:
    return " / ".join(f"{100 * share:.0f}" for share in shares)
