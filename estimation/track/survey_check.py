"""What is wrong with a survey that the passes contradict: section, unit, sign or place of it, or its gauge.

It is compared with the alignment that the fleet finds without it, both after the same high-pass, at every offset that
is searched. Whether the passes contradict it is not decided here but in ``survey_verdict``.

The gauge moves wheelsets of different wear apart. Where the passes of a place disagree by more than their sensors make
them, and the gauge on file takes less off that than one of its size should, it is that of another place or time.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import fft

from estimation.filters import between_known, high_pass, local_cubic_kernel, valid_support
from estimation.track.gauge.wheel_functions import WHEELS, contact_samples, gauge_factor_with_std
from estimation.track.iteration import IterationResult
from estimation.track.parameters import TRACK
from estimation.track.positions import peak_position
from estimation.track.settings import SectionParameters
from estimation.values.arrays import FloatArray
from estimation.values.quantities import log10_chance
from estimation.values.reasons import Reason, ReasonCode, combined
from estimation.values.track import TrackAlignment

UNITS = {
    1e3: "millimetres were taken for metres",
    1e-3: "metres were taken for millimetres",
    1e2: "centimetres were taken for metres",
    1e-2: "metres were taken for centimetres",
    1e1: "millimetres were taken for centimetres",
    1e-1: "centimetres were taken for millimetres",
    25.4: "millimetres were taken for inches",
    1 / 25.4: "inches were taken for millimetres",
    1 / 0.0254: "inches were taken for metres",
    0.0254: "metres were taken for inches",
    1 / 0.3048: "feet were taken for metres",
    0.3048: "metres were taken for feet",
}
NOT_ASSESSABLE = Reason(ReasonCode.SURVEY_NOT_ASSESSABLE, "the fleet does not know enough of the section")


@dataclass(frozen=True, slots=True)
class SurveyCheckParameters:
    """When two alignments are of one section, in one unit, at one place."""

    largest_offset: float = 60.0  # m, searched both ways
    log10_chance: float = -6.0  # of as much in common with another section, over all offsets
    least_samples: float = 20.0  # independent ones, below which the survey is not assessed
    most_factor: float = 1.25  # and its inverse the least, besides what the fleet leaves open
    largest_shift: float = 3.0  # m, besides the uncertainty of the fleet's place
    same_unit: float = 1.12  # a factor this near to that of a unit is that unit


@dataclass(frozen=True, slots=True)
class SurveyCheck:
    """The check of a surveyed alignment by the fleet; numbers are NaN where it cannot be assessed."""

    reason: Reason | None  # why it is not usable; or why it cannot be assessed
    scale: float  # surveyed over measured, without its sign
    shift: float  # m: what is surveyed at s was measured at s + shift
    sign: int  # 1; -1 where left and right are exchanged; 0 where it cannot be assessed
    correlation: float  # at the best shift
    samples: float  # independent ones
    usable: bool = True


def check_survey(recorded: TrackAlignment, fleet: TrackAlignment, *, place_std: float = 0.0) -> SurveyCheck:
    """Return whether a recorded alignment may be used, by that of the fleet alone, high-passed, NaN where not known.

    A shift within ``place_std``, m, of the position of the fleet as a whole is not held against the survey.
    """
    p = SurveyCheckParameters()
    nan = float("nan")
    nothing = SurveyCheck(NOT_ASSESSABLE, nan, nan, 0, nan, 0.0)
    both = _on_one_grid(recorded, fleet)
    if both is None:
        return nothing
    r, f, variance, step = both
    reach = int(p.largest_offset / step)
    score, factor = _by_lag(r, f, 1.0 / variance, reach)
    k = int(np.argmax(np.abs(score)))
    shift = (peak_position(np.abs(score), k) - reach) * step
    memory = _memory(r, f, step)
    samples = np.count_nonzero(f) * step / memory
    if samples < p.least_samples:
        return nothing
    explained = min(float(score[k] ** 2), 1.0 - 1e-12)
    chance = log10_chance(-(samples - 3.0) * float(np.log1p(-explained)), 1)
    chance += float(np.log10(max(2.0 * p.largest_offset / memory, 1.0)))
    scale, sign, correlation = float(np.abs(factor[k])), int(np.sign(factor[k])), float(np.sqrt(explained))
    found = SurveyCheck(None, scale, shift, sign, correlation, samples)
    if chance > p.log10_chance:
        text = (
            "it has no more in common with what the fleet has measured than another section would"
            f" (correlation {found.correlation:.2f} over {samples:.0f} independent samples)"
        )
        return replace(found, usable=False, reason=Reason(ReasonCode.SURVEY_UNRELATED, text))
    misplaced = combined(_misplaced(found, 1.0 + 4.0 * fleet.scale_std, 3.0 * place_std, p))
    return found if misplaced is None else replace(found, usable=False, reason=misplaced)


def worth_more(fleet: TrackAlignment, survey: TrackAlignment) -> bool:
    """Return whether an alignment of the fleet is certain enough to stand for a survey that is wrong."""
    both = _on_one_grid(survey, fleet)
    if both is None:
        return False
    r, f, _, _ = both
    compared = (r != 0.0) & (f != 0.0)
    wrong = float(np.sqrt(np.mean((f - r)[compared] ** 2))) if compared.any() else 0.0
    std = float(np.nanmedian(fleet.alignment_std))
    return std < TRACK.worthwhile_std and std < TRACK.worthwhile_share * wrong


def _misplaced(found: SurveyCheck, open_scale: float, place_known: float, p: SurveyCheckParameters) -> list[Reason]:
    """Return what is wrong with unit, sides and place, beyond a factor and a shift, m, that the fleet leaves open."""
    reasons = []
    if not 1.0 / (p.most_factor * open_scale) <= found.scale <= p.most_factor * open_scale:
        reasons.append(Reason(ReasonCode.SURVEY_UNIT, _unit(found.scale, p)))
    if found.sign < 0:
        text = "left and right are exchanged: it is the mirror image of what the fleet has measured"
        reasons.append(Reason(ReasonCode.SURVEY_MIRRORED, text))
    if abs(found.shift) > p.largest_shift + place_known:
        within = f", and the fleet knows its place within {place_known:.1f} m" if place_known > 0.0 else ""
        direction = "back" if found.shift > 0.0 else "along"
        text = f"it is {abs(found.shift):.1f} m too far {direction}{within}"
        reasons.append(Reason(ReasonCode.SURVEY_DISPLACED, text))
    return reasons


def _unit(scale: float, limits: SurveyCheckParameters) -> str:
    near = min(UNITS, key=lambda factor: abs(np.log(scale / factor)))
    text = f"it is {scale:.3g} times what the fleet has measured"
    return f"{text}: {UNITS[near]}" if abs(np.log(scale / near)) < np.log(limits.same_unit) else text


def _on_one_grid(
    recorded: TrackAlignment, fleet: TrackAlignment
) -> tuple[FloatArray, FloatArray, FloatArray, float] | None:
    step = float(fleet.s[1] - fleet.s[0])
    known = np.isfinite(recorded.alignment) & np.isfinite(recorded.alignment_std)
    inside = between_known(fleet.s, recorded.s, known)
    surveyed = np.isfinite(recorded.alignment)
    if not inside.any():
        return None
    r = np.interp(fleet.s, recorded.s[surveyed], recorded.alignment[surveyed])
    if fleet.band_limited and not recorded.band_limited:
        weights = local_cubic_kernel(fleet.cutoff_wavelength, step)
        inside = valid_support(inside, weights)
        r = high_pass(r, weights)
    seen = inside & np.isfinite(fleet.alignment) & np.isfinite(fleet.alignment_std)
    if np.count_nonzero(seen) * step < 2.0 * TRACK.correlation_length:
        return None
    std = np.interp(fleet.s, recorded.s, np.nan_to_num(recorded.alignment_std))
    variance = std**2 + np.where(seen, np.nan_to_num(fleet.alignment_std), 0.0) ** 2
    variance = np.maximum(variance, (1e-6) ** 2)
    return np.where(inside, r, 0.0), np.where(seen, fleet.alignment, 0.0), variance, step


def _by_lag(r: FloatArray, f: FloatArray, weight: FloatArray, reach: int) -> tuple[FloatArray, FloatArray]:
    """Return correlation and factor (2 reach + 1,) of r(s) with f(s + lag), by the errors of f."""
    seen = (f != 0.0).astype(np.float64) * weight
    size = fft.next_fast_len(len(r) + reach, real=True)
    lags = np.arange(-reach, reach + 1)

    def products(a: FloatArray, b: FloatArray) -> FloatArray:
        return np.asarray(fft.irfft(np.conj(fft.rfft(a, size)) * fft.rfft(b, size), size)[lags])

    cross = products(r, seen * f)
    own = np.maximum(products(r * r, seen), 1e-300)
    measured = np.maximum(products((r != 0.0).astype(np.float64), seen * f * f), 1e-300)
    return cross / np.sqrt(own * measured), cross / measured


def _memory(r: FloatArray, f: FloatArray, step: float) -> float:
    """Return over how many m one independent sample of the product reaches (Bartlett)."""
    far = min(int(TRACK.correlation_length / step), len(r) - 1)
    size = fft.next_fast_len(len(r) + far, real=True)
    own = [fft.irfft(np.abs(fft.rfft(signal, size)) ** 2, size)[: far + 1] for signal in (r, f)]
    first, second = (values / max(float(values[0]), 1e-300) for values in own)
    return step * max(1.0 + 2.0 * float((first[1:] * second[1:]).sum()), 1.0)


@dataclass(frozen=True, slots=True)
class GaugeLimits:
    """When a surveyed gauge is right."""

    visible: float = 0.1e-3  # m, rms of y - d - h(R) without it, from which on a gauge shows
    least_expected: float = 0.1  # of the square of that, which a gauge of its size must make for it to be judged
    least_explained: float = 0.25  # of what is expected
    most_scale: float = 1.3  # by which it may be too large or too small, besides the std of that
    stds: float = 3.0  # that count as beyond doubt


def judge_gauge(
    iterated: IterationResult | None, survey: TrackAlignment, *, converged: bool, parameters: SectionParameters
) -> Reason | None:
    """Return what is wrong with a surveyed gauge; None where nothing is, or what passes show is not certain yet."""
    p = GaugeLimits()
    size = float(np.std(survey.gauge_deviation))
    if iterated is None or iterated.panel.gauge is None or not (converged and survey.gauge_known):
        return None
    before, after = iterated.noise_without_gauge, iterated.noise
    if size < WHEELS.least_gauge_std or before < p.visible:
        return None
    expected = min((parameters.gauge_effect * size / before) ** 2, 1.0)
    if expected < p.least_expected:
        return None
    if 1.0 - (after / before) ** 2 < p.least_explained * expected:
        text = (
            f"of the {1e3 * before:.2f} mm by which passes disagree {1e3 * after:.2f} mm remain with it;"
            " it is that of another place, or displaced"
        )
        return Reason(ReasonCode.SURVEY_GAUGE_UNRELATED, text)
    factor, std = gauge_factor_with_std(contact_samples(iterated.passes, iterated.solution, iterated.panel))
    if abs(np.log(factor)) > np.log(p.most_scale) + p.stds * std:  # never where the std is not known
        return Reason(ReasonCode.SURVEY_GAUGE_UNIT, f"it is {1.0 / factor:.2g} times what the wheelsets show")
    return None
