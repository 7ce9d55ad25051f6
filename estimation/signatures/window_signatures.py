"""A window in; the signatures of its wheelset over the places that it passed out, or why there are none."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from estimation.filters import local_cubic_kernel
from estimation.motion.checks import check_integrated, check_running, direction, gate, moving_samples, straight_part
from estimation.motion.integration import (
    IntegratedSegment,
    IntegratedWindow,
    SignalParameters,
    WindowParameters,
    integrate,
)
from estimation.motion.rolling_radius_difference import FUSED, fuse, motion_signals, sample_smoothed
from estimation.signatures.parameters import SIGNATURE
from estimation.values.arrays import FloatArray
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.signatures import POWERS, SIGNALS, AxlePosition, LibraryEntry, Place, Signature
from estimation.values.track import TrackLayout
from estimation.values.windows import Window


@dataclass(frozen=True, slots=True)
class SignatureParameters:
    """How windows become signatures, and what a library must hold before it answers; lengths in m."""

    step: float = 0.25
    cell: float = 256.0  # of a section
    block: float = 128.0  # of one spectrum; blocks of a cell overlap by half
    wavelengths: tuple[float, ...] = (45.0, 30.0, 20.0, 15.0, 11.0, 8.0, 6.0, 4.5, 3.3)  # ends of the bands
    least_wheelsets: int = 8  # of known conicity
    most_entries: int = 4000  # of one class, axle position and pair of profiles: the newest
    least_sections: int = 3  # for an answer about places that the library does not have
    least_spread: float = 0.015  # std of the conicities of the library
    most_std: float = 0.03  # of a conicity that is learned from
    most_mileage_km: float = 10_000.0  # between a signature and the conicity that it is learned with
    margin: float = 0.01  # of conicity, by which an answer may be outside those of the library
    speed_margin: float = 1.0  # m/s, the same of speed
    states: tuple[float, ...] = (0.10, 0.15, 0.20, 0.25, 0.30, 0.35)  # conicities between seven states of wear
    answer_std: float = 0.006  # of an answer about one wheelset on one section, before any is seen
    answer_spread: float = 0.3  # std of its logarithm
    reluctance: int = 3  # power of what is in common, by which shares are less likely beforehand
    factor_std: float = 0.3  # of the logarithm of the factor on standard deviations, before any answer is seen
    least_passes: int = 3  # on either side of a change
    library_rounds: int = 2  # in which the times of changes and the scatter about them are found
    largest_distance: float = 5.5  # squared distance over the number of features, from which on a place has changed
    most_own_folds: int = 12  # families, up to which each of them is a fold of its own
    signal_pairs: tuple[tuple[int, int], ...] = ((0, 1), (0, 2), (1, 2))
    end_margin: float = 10.0  # m that are left out at each end of a segment
    least_std: float = 0.003  # of a conicity from measured profiles
    speed_band: float = 5.0  # m/s: of each wheelset, place and band the newest signature is an entry

    @property
    def bands(self) -> int:
        """Number of bands of wavelength."""
        return len(self.wavelengths) - 1


def families(groups: Iterable[frozenset[str]]) -> list[frozenset[str]]:
    """Return groups of wheelsets that share no data with each other, in the order of their first serials."""
    member: dict[str, set[str]] = {}
    for group in set(groups):
        joined = set(group).union(*(member[name] for name in group if name in member))
        member.update(dict.fromkeys(joined, joined))
    return sorted({frozenset(names) for names in member.values()}, key=min)


def folds(entries: Sequence[LibraryEntry], parameters: SignatureParameters) -> list[frozenset[str]]:
    """Return wheelsets that are left out together, none of whose data are in entries of others."""
    # In a small library each family is a fold. In a larger one there are six, each with all kinds of conicity.
    conicities: dict[str, list[float]] = {}
    for entry in entries:
        conicities.setdefault(entry.wheelset, []).append(entry.conicity)
    alone = families(sharers(entry) for entry in entries)
    if len(alone) <= parameters.most_own_folds:
        return alone
    mean = {name: sum(values) / len(values) for name, values in conicities.items()}
    ordered = sorted(alone, key=lambda names: (min(mean[name] for name in names if name in mean), min(names)))
    return [frozenset().union(*ordered[first :: SIGNATURE.fold_count]) for first in range(SIGNATURE.fold_count)]


def sharers(entry: LibraryEntry) -> frozenset[str]:
    """Return the wheelsets whose samples are in an entry."""
    return frozenset(entry.shares_data) | {entry.wheelset}


def band_spectra(signals: FloatArray, parameters: SignatureParameters) -> tuple[FloatArray, float]:
    """Return the mean cross-spectra (b, 9) of a stretch in the bands, and the wavelength at which R is strongest, m.

    Blocks lose their mean and slope and have Hann's window; they overlap by half (P. D. Welch, IEEE Trans. Audio and
    Electroacoustics 15, 1967). Signals (3, n) are y in m, R in m, roll in rad, every ``step`` m.
    """
    size = round(parameters.block / parameters.step)
    starts = range(0, signals.shape[1] - size + 1, size // 2)
    total = sum((_products(signals[:, at : at + size]) for at in starts), np.zeros((SIGNALS, SIGNALS, size // 2 + 1)))
    mean = total / (len(starts) * np.sum(np.hanning(size) ** 2) / parameters.step)
    wavenumber = np.asarray(np.fft.rfftfreq(size, parameters.step), dtype=np.float64)
    ends = 1.0 / np.array(parameters.wavelengths)
    inside = [(wavenumber >= low) & (wavenumber < high) for low, high in pairwise(ends)]
    bands = np.stack([mean[:, :, chosen].mean(axis=2) for chosen in inside])  # (b, 3, 3)
    columns = [bands[:, i, i].real for i in range(POWERS)]
    for i, k in parameters.signal_pairs:
        columns += [bands[:, i, k].real, bands[:, i, k].imag]
    return np.stack(columns, axis=1), _peak(mean[1, 1].real, wavenumber, ends)


def _products(block: FloatArray) -> FloatArray:
    n = block.shape[1]
    t = np.arange(n) - 0.5 * (n - 1)
    level = block - block.mean(axis=1, keepdims=True)
    straight = level - ((level @ t) / (t @ t))[:, None] * t
    waves = np.fft.rfft(straight * np.hanning(n))
    return np.asarray(waves[:, None, :] * waves[None, :, :].conj())


def _peak(power: FloatArray, wavenumber: FloatArray, ends: FloatArray) -> float:
    smooth = np.convolve(power, np.ones(3) / 3, mode="same")
    chosen = (wavenumber >= ends[0]) & (wavenumber < ends[-1])
    return float(1.0 / wavenumber[chosen][np.argmax(smooth[chosen])])


@dataclass(frozen=True, slots=True)
class _Stretch:
    first: int  # number of the first grid point
    signals: FloatArray  # (3, n)
    speed: FloatArray  # (n,) m/s


def window_signatures(
    window: Window, parameters: WindowParameters, signature: SignatureParameters, layout: TrackLayout | None = None
) -> tuple[Signature, ...] | Reason:
    """Return the signatures of a window, one for each cell of the section that it passed whole."""
    # where section or position are not known every stretch of that length has one, without a place
    placed = gate(window.quality, window.track_section, parameters.gates)
    if placed is not None:
        if placed.code not in {ReasonCode.SECTION_UNKNOWN, ReasonCode.POSITION_UNKNOWN}:
            return placed
        run = np.cumsum(np.nan_to_num(window.speed)) * window.sample_interval_s
        window = replace(window, track_section=None, distance=run)  # at distances from its own begin
    checked = _checked(window, parameters.signals, None if placed else layout)
    if isinstance(checked, Reason):
        return checked
    section = None if placed else window.track_section
    stretches = [_stretch(segment, window, parameters, direction(checked.window)) for segment in checked.segments]
    found: list[Signature] = []
    for stretch in stretches:
        for cell, part in _cells(stretch, signature):
            spectra, peak = band_spectra(stretch.signals[:, part], signature)
            found.append(
                Signature(
                    wheelset=window.wheelset,
                    vehicle=window.vehicle,
                    vehicle_class=parameters.vehicle_class.code,
                    position=axle_position(window, parameters),
                    start_ns=window.start_ns,
                    order=len(found),
                    place=None if section is None else Place(section, cell),
                    speed=float(np.mean(stretch.speed[part])),
                    spectra=spectra,
                    peak_wavelength=peak,
                )
            )
    if not found:
        return Reason(ReasonCode.PASS_TOO_SHORT, f"no stretch of {signature.cell:g} m was passed whole")
    moving = tuple(one for one in found if one.finite)
    return moving or Reason(ReasonCode.NOT_FINITE, "a signal does not move, or is no finite number")


def axle_position(window: Window, parameters: WindowParameters) -> AxlePosition:
    """Return where the wheelset of a window runs in its bogie."""
    # the axle of the lower number is in front where the vehicle runs forwards
    partner = parameters.vehicle_class.partner(window.axle)
    if partner is None:
        return AxlePosition.SINGLE
    return AxlePosition.LEADING if (window.axle < partner) != window.backwards else AxlePosition.TRAILING


def _checked(window: Window, signals: SignalParameters, layout: TrackLayout | None) -> IntegratedWindow | Reason:
    straight = check_running(window, signals) or straight_part(window, layout, signals)
    if isinstance(straight, Reason):
        return straight
    integrated = integrate(straight, moving_samples(straight, signals), signals)
    if not integrated.segments:
        return Reason(ReasonCode.INTERRUPTED, f"no uninterrupted run of {signals.shortest_segment_s:g} s")
    return check_integrated(integrated)


def _stretch(segment: IntegratedSegment, window: Window, parameters: WindowParameters, way: int) -> _Stretch:
    given = np.flatnonzero(segment.known)
    place = np.interp(np.arange(len(segment.known)), given, window.distance[segment.part][given])
    run = np.maximum.accumulate(way * place) + SIGNATURE.least_step * np.arange(len(place))
    fused = fuse(motion_signals(segment, parameters.vehicle, run), parameters.vehicle)
    first, count = round(float(fused.run[0]) / FUSED.grid_step), len(fused.run)
    fine = FUSED.grid_step / FUSED.oversampling
    weights = local_cubic_kernel(FUSED.shortest_waves[1], fine)
    others = np.stack([segment.displacements[2], segment.speed])
    roll, speed = sample_smoothed(others, run, FUSED.oversampling * first, count, FUSED.oversampling, fine, weights)
    begin = first if way > 0 else -(first + count - 1)
    signals = np.stack([fused.displacement, fused.difference, roll])
    return _Stretch(begin, np.asarray(signals[:, ::way]), np.asarray(speed[::way]))


def _cells(stretch: _Stretch, parameters: SignatureParameters) -> Iterator[tuple[int, slice]]:
    size = round(parameters.cell / parameters.step)
    margin = round(parameters.end_margin / parameters.step)
    first, behind = stretch.first + margin, stretch.first + stretch.signals.shape[1] - margin
    for cell in range(-(-first // size), behind // size):
        begin = cell * size - stretch.first
        yield cell, slice(begin, begin + size)
