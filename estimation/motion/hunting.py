"""Hunting: a wheelset that keeps swaying at its own wavelength, whatever the track does.

Above its critical speed a wheelset sways from flange to flange: sustained, narrow in frequency, large, with the yaw of
the kinematic mode (V psi = y', so that the yaw acceleration is i omega / V times the lateral one). Track irregularity
makes it sway at the same wavelength, but the amplitude comes and goes, which widens the line in the spectrum; impacts
and curves have no line, and a rigid body that sways has no yaw to go with it.

Flange contact drives sensors to their limits. The line remains: what is cut off the peaks of an oscillation lowers its
amplitude and adds odd harmonics, but does not widen it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
import numpy.typing as npt

from estimation.compiled import compiled
from estimation.values.arrays import BoolArray, FloatArray
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.windows import NOT_HUNTING, Hunting, WindowQuality, fast_enough


@dataclass(frozen=True, slots=True)
class HuntingParameters:
    """What hunting is."""

    block_s: float = 5.0  # over which the oscillation must be sustained
    least_speed: float = 8.0  # m/s
    least_known_share: float = 0.3  # share of a block's samples; what is between is bridged straight
    longest_wave: float = 40.0  # m, wavelengths of hunting; a wheel out of round has less
    shortest_wave: float = 3.5
    least_frequency: float = 0.8  # Hz
    line_band: tuple[float, float] = (0.75, 1.33)  # of the peak's frequency
    # amplitude from which on, m; least share of the displacement's power in the line; its largest relative width
    steady_limits: tuple[float, float, float] = (2.5e-3, 0.55, 0.05)
    flange_limits: tuple[float, float, float] = (5e-3, 0.9, 0.11)  # of which rough track disturbs the rhythm
    least_coherence: float = 0.8  # between lateral and yaw acceleration in the line
    most_phase: float = np.pi / 3.0  # from the kinematic mode
    gain_range: tuple[float, float] = (0.3, 3.0)  # of yaw, times what the kinematic mode has
    doubt_share: float = 1e-6  # relative: blocks this near to a limit are looked at once more


HUNTS = HuntingParameters()
LONGEST, SHORTEST = HUNTS.longest_wave, HUNTS.shortest_wave
LEAST_FREQUENCY = HUNTS.least_frequency
LINE = HUNTS.line_band
STEADY = HUNTS.steady_limits
FLANGE_TO_FLANGE = HUNTS.flange_limits
DOUBT = HUNTS.doubt_share
QUALITY_REASONS = frozenset(
    {
        ReasonCode.TOO_FEW_SAMPLES,
        ReasonCode.CLIPPED,
        ReasonCode.NO_USABLE_SAMPLE,
        ReasonCode.INTERRUPTED,
        ReasonCode.TOO_FEW_USABLE,
        ReasonCode.OUTSIDE_BINS,
    }
)


@dataclass(frozen=True, slots=True)
class _Line:
    """The strongest line of a block."""

    frequency_hz: float
    amplitude: float  # m
    share: float  # of the displacement's power
    width: float  # relative
    coherence: float
    phase: float  # rad, from the kinematic mode
    gain: float

    @property
    def hunts(self) -> bool:
        """Whether it is that of hunting."""
        sustained = any(
            self.amplitude >= amplitude and self.share >= share and self.width <= width
            for amplitude, share, width in (STEADY, FLANGE_TO_FLANGE)
        )
        least, most = HUNTS.gain_range
        kinematic = abs(self.phase) <= HUNTS.most_phase and least <= self.gain <= most
        return sustained and kinematic and self.coherence >= HUNTS.least_coherence


def find_hunting(lateral: FloatArray, yaw: FloatArray, speed: FloatArray, interval_s: float) -> Hunting:
    """Return how much of some running time a wheelset hunts, at which frequency and how far.

    ``lateral`` and ``yaw`` (n,) are as the sensors gave them, clipped samples too; NaN where nothing is known.
    """
    size = round(HUNTS.block_s / interval_s)
    blocks = (len(lateral) // size, size)
    lateral, yaw, speed = (signal[: blocks[0] * size].reshape(blocks) for signal in (lateral, yaw, speed))
    fast = np.nan_to_num(np.mean(speed, axis=1))
    running = np.flatnonzero(fast_enough(fast, HUNTS.least_speed))
    likely = running[_may_hunt(lateral[running], yaw[running], fast[running], interval_s)]
    lines = (_line(lateral[block], yaw[block], float(fast[block]), interval_s) for block in likely)
    hunting = [(line.frequency_hz, line.amplitude) for line in lines if line is not None and line.hunts]
    if not hunting:
        return NOT_HUNTING
    frequency, amplitude = np.median(hunting, axis=0).tolist()
    return Hunting(len(hunting) / len(running), frequency, amplitude)


def _may_hunt(lateral: FloatArray, yaw: FloatArray, speed: FloatArray, interval_s: float) -> BoolArray:
    """Return of which blocks (k,) the lateral motion alone is enough for hunting; most are not looked at further."""
    known = np.isfinite(lateral) & np.isfinite(yaw)
    enough = known.mean(axis=1) >= HUNTS.least_known_share
    if not known.all():
        lateral = lateral.copy()
        number = np.arange(lateral.shape[1])
        for block in np.flatnonzero(enough & ~known.all(axis=1)):
            lateral[block] = np.interp(number, number[known[block]], lateral[block, known[block]])
        lateral[~enough] = 0.0
    window, square = _window(lateral.shape[1])
    spectra = np.fft.rfft((lateral - lateral.mean(axis=1, keepdims=True)) * window)
    frequency: FloatArray = np.asarray(np.fft.rfftfreq(lateral.shape[1], interval_s), np.float64)
    return np.asarray(enough & may_hunt(spectra, speed, frequency, square * lateral.shape[1]))


@compiled(nogil=True)
def may_hunt(spectra: npt.NDArray[np.complex128], speed: FloatArray, frequency: FloatArray, scale: float) -> BoolArray:
    """Return which blocks (k,) have a line that is as large, as much of the whole and as narrow as that of hunting.

    Those that are within :data:`DOUBT` of a limit are among them, and those whose strongest line is not clear.
    """
    may_be = np.zeros(len(speed), np.bool_)
    power = np.zeros(len(frequency) + 2)  # of the displacement; one more on either side
    for block in range(len(speed)):
        slowest, fastest = max(LEAST_FREQUENCY, speed[block] / LONGEST), speed[block] / SHORTEST
        for k in range(len(frequency)):
            omega, a = 2.0 * np.pi * frequency[k], spectra[block, k]
            inside = slowest <= frequency[k] <= fastest
            power[k + 1] = (a.real**2 + a.imag**2) / omega**4 if inside else 0.0
        may_be[block] = line_may_hunt(power, frequency, scale)
    return may_be


@compiled(nogil=True)
def line_may_hunt(power: FloatArray, frequency: FloatArray, scale: float) -> bool:
    """Return whether the strongest line of a block may be that of hunting; see :func:`may_hunt`."""
    total = best = 0.0
    for k in range(len(frequency)):
        total += power[k + 1]
        best = max(best, power[k] + power[k + 1] + power[k + 2])
    peak, strongest = 0.0, 0
    for k in range(len(frequency)):
        if power[k] + power[k + 1] + power[k + 2] >= best * (1.0 - DOUBT):
            peak = frequency[k]
            strongest += 1
    of_line = moment = square = 0.0
    for k in range(len(frequency)):
        if LINE[0] * peak < frequency[k] < LINE[1] * peak:
            of_line += power[k + 1]
            moment += power[k + 1] * (frequency[k] - peak)
            square += power[k + 1] * (frequency[k] - peak) ** 2
    if strongest != 1 or not of_line > 0.0:
        return total > 0.0
    off = moment / of_line
    amplitude, share = np.sqrt(4.0 * of_line / scale) * (1.0 + DOUBT), of_line / total * (1.0 + DOUBT)
    width = np.sqrt(max(square / of_line - off**2, 0.0)) / (peak + off) - DOUBT
    hunts = False
    for limits in (STEADY, FLANGE_TO_FLANGE):
        hunts = hunts or (amplitude >= limits[0] and share >= limits[1] and width <= limits[2])
    return hunts


@cache
def _window(size: int) -> tuple[FloatArray, float]:
    window = np.hanning(size)
    window.flags.writeable = False
    return window, float((window**2).sum())


def _line(lateral: FloatArray, yaw: FloatArray, speed: float, interval_s: float) -> _Line | None:
    known = np.isfinite(lateral) & np.isfinite(yaw)
    if known.mean() < HUNTS.least_known_share:
        return None
    number = np.arange(len(lateral))
    window, window_power = _window(len(lateral))
    both = [np.interp(number, number[known], signal[known]) for signal in (lateral, yaw)]
    a, b = (np.fft.rfft((signal - signal.mean()) * window) for signal in both)
    frequency = np.fft.rfftfreq(len(lateral), interval_s)
    slowest = max(LEAST_FREQUENCY, speed / LONGEST)
    inside = (frequency >= slowest) & (frequency <= speed / SHORTEST)
    if not inside.any():
        return None
    omega = np.where(inside, 2.0 * np.pi * frequency, 1.0)
    y, turned = np.where(inside, a / omega**2, 0.0), np.where(inside, b * speed / (1j * omega**3), 0.0)
    power = np.abs(y) ** 2
    peak = frequency[int(np.argmax(np.convolve(power, np.ones(3), "same")))]
    line = inside & (frequency > LINE[0] * peak) & (frequency < LINE[1] * peak)
    total, of_line = float(power.sum()), power[line]
    if total <= 0.0:
        return None
    middle = float(of_line @ frequency[line] / of_line.sum())
    cross = complex(np.vdot(y[line], turned[line]))
    other = float((np.abs(turned[line]) ** 2).sum())
    return _Line(
        frequency_hz=middle,
        amplitude=float(np.sqrt(4.0 * of_line.sum() / window_power / len(lateral))),
        share=float(of_line.sum()) / total,
        width=float(np.sqrt(of_line @ (frequency[line] - middle) ** 2 / of_line.sum())) / middle,
        coherence=abs(cross) / float(np.sqrt(of_line.sum() * other)) if other > 0.0 else 0.0,
        phase=float(np.angle(cross)),
        gain=abs(cross) / float(of_line.sum()),
    )


def hunting_reason(quality: WindowQuality) -> Reason | None:
    """Return that a window is one of hunting; None where it is not."""
    hunting = quality.hunting
    if not hunting.sustained:
        return None
    return Reason(
        ReasonCode.HUNTING,
        f"the wheelset hunts for {hunting.share:.0%} of the time, at {hunting.frequency_hz:.1f} Hz and"
        f" {1e3 * hunting.amplitude:.1f} mm or more",
    )


def in_place_of_quality(reason: Reason, quality: WindowQuality) -> Reason:
    """Return that the wheelset hunts where the reason of a refusal is what hunting does to the samples."""
    hunts = hunting_reason(quality) if reason.code in QUALITY_REASONS else None
    return reason if hunts is None else Reason(hunts.code, f"{hunts.text}; {reason.text}")
