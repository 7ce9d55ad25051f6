"""The alignment of a section from the stiff bogies that run over it, where none is on file.

Any alignment fits one bogie whose curves are unknown; but d is that of the place for both axles, all runs, all bogies.
Every round solves for the unknowns of all bogies and for d together: d is eliminated wave by wave, at the mean slope of
the curves. Its waves beyond ``carried_wave`` are those by which simulated bogies move as the measured ones do.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np

from estimation.bogie.curves import Curves
from estimation.bogie.fit import Beforehand, Reached
from estimation.bogie.parameters import BOGIE, BOGIE_TRACK
from estimation.bogie.signals import BogieRun, placed
from estimation.bogie.simulation import simulate
from estimation.bogie.sums import (
    ComplexArray,
    Grid,
    MeasuredRun,
    Spectra,
    as_it_runs,
    band,
    error_spectrum,
    in_segments,
    normal,
    segment_cells,
)
from estimation.values.arrays import FloatArray, FrozenArrays
from estimation.values.reasons import Reason, ReasonCode

BogieAndRun = tuple[int, BogieRun]
TAPERED = 3.0 / 8.0  # mean square of the taper of segments


@dataclass(frozen=True, slots=True)
class FoundAlignment(FrozenArrays):
    """What bogies say of a section; NaN where too few have run."""

    place: Annotated[FloatArray, "n"]  # m along the section
    alignment: Annotated[FloatArray, "n"]  # m
    std: Annotated[FloatArray, "n"]  # m, of y - d by it: a bogie follows long waves, whatever they are
    runs: Annotated[FloatArray, "n"]  # that have passed
    shift: Annotated[FloatArray, "r"]  # m along the section, by which each run is further than it was taken to be
    moved: float  # m, rms by which the last round changed the alignment


@dataclass(frozen=True, slots=True)
class _Piece:
    """A run in segments that are the same for all runs; along the section whichever way it ran."""

    bogie: int
    run: BogieRun
    first: int  # number of its first segment
    spectra: Spectra
    ahead_of: ComplexArray  # (s, 2, m) y measured less simulated
    simulated: ComplexArray  # (s, 2, m) y
    under: ComplexArray  # (s, m) d under the axle that leads
    slope: FloatArray  # (2,) of the curves by d, mean

    @property
    def weight(self) -> float:
        """What its y counts: accelerations that are integrated twice are less noisy where a wave passes faster."""
        return (float(self.run.speed.mean()) / BOGIE.usual_speed) ** 4

    def turned(self, response: ComplexArray) -> ComplexArray:
        """Return a response in the direction of travel along the section, or one along it in that of travel."""
        return response if self.run.onward > 0.0 else response.conj()

    @property
    def numbers(self) -> range:
        """Of its segments."""
        return range(self.first, self.first + len(self.under))


def _piece(bogie: int, run: BogieRun, reached: Reached) -> _Piece | None:
    own = as_it_runs(reached.curves, run)
    moved = simulate(reached.gear, own, run)
    if moved is None:
        return None
    size, hop = segment_cells(), segment_cells() // 2
    way = run.onward * run.place[0, run.place.shape[1] - len(run) :] / BOGIE.grid_step
    origin = int(np.ceil(way[0]))
    cell = np.maximum(way - origin, 0.0)
    numbers = range(-(-origin // hop), (origin + int(cell[-1]) - size) // hop + 1)
    grid = Grid(cell, [number * hop - origin for number in numbers])
    measured = MeasuredRun.on(grid, 0, run, reached.gear.vehicle.nominal_radius)
    part = in_segments(reached.gear, own, measured, moved, grid)
    rows = np.concatenate([run.lateral[0] - moved.lateral[0], moved.lateral[0], run.track[:1]])
    along, first = np.moveaxis(grid.transformed(rows), 1, 0), numbers.start
    if run.onward < 0.0:
        turn = np.exp(-2j * np.pi * band() * (size - 1) / size)
        first, along = -(numbers.stop + 1), along[::-1].conj() * turn
        part = replace(
            part,
            target=part.target[::-1].conj() * turn,
            measured=part.measured.backwards(turn),
            simulated=part.simulated.backwards(turn),
        )
    slope = run.stretch * own.slope(moved.relative).mean(axis=1)
    return _Piece(bogie, run, first, part, along[:, :2], along[:, 2:4], along[:, 4], slope)


@dataclass(frozen=True, slots=True)
class _Solved:
    """The unknowns of all bogies together, and by what d is another."""

    theta: Sequence[FloatArray]  # by bogie
    waves: ComplexArray  # (g, m) of d
    whole: FloatArray  # (u, u) information on the unknowns with d eliminated
    columns: ComplexArray  # (g, m, u) by what d changes with them
    weight: FloatArray  # (g, m) information on d where they are known

    def variance(self) -> FloatArray:
        """Return the variance (g, m) of d: by the errors of the equations, and by the curves."""
        columns = self.columns.reshape(-1, len(self.whole))
        of_curves = np.einsum("cu,cu->c", columns @ np.linalg.inv(self.whole), columns.conj()).real
        return np.asarray(1.0 / self.weight + np.maximum(of_curves, 0.0).reshape(self.weight.shape))


@dataclass(frozen=True, slots=True)
class _Section:
    """Where the rounds have come to."""

    known: Sequence[Beforehand]  # by bogie
    reached: Sequence[Reached]
    d: FloatArray  # (n,) m, in cells from the begin of the section
    pieces: Sequence[_Piece]

    @property
    def segments(self) -> int:
        return 2 * len(self.d) // segment_cells() - 1

    def runs(self) -> list[BogieAndRun]:
        """Return the runs, each where its simulation follows best."""
        shifts = [piece.run.onward * piece.spectra.followed.shift for piece in self.pieces]
        away = [shift - float(np.mean(shifts)) for shift in shifts]
        return [
            (piece.bogie, placed(piece.run, piece.run.onward * shift))
            for piece, shift in zip(self.pieces, away, strict=True)
        ]

    def response(self) -> ComplexArray:
        """Return the linear response (b, 2, m) of the y of both axles to the d under the first, as it travels."""
        found = np.zeros((len(self.known), 2, len(band())), dtype=np.complex128)
        power = np.full((len(self.known), len(band())), np.finfo(np.float64).tiny)
        for piece in self.pieces:
            found[piece.bogie] += piece.turned((piece.simulated * piece.under.conj()[:, None]).sum(axis=0))
            power[piece.bogie] += (np.abs(piece.under) ** 2).sum(axis=0)
        return np.asarray(found / power[:, None])

    def by_motion(self, response: ComplexArray) -> tuple[ComplexArray, FloatArray]:
        """Return by what d (g, m) bogies move otherwise than they are simulated to, and its variance."""
        change = np.zeros((self.segments, len(band())), dtype=np.complex128)
        weight, power, count = np.zeros(change.shape), np.zeros(len(band())), 0
        for piece in self.pieces:
            own = piece.turned(response[piece.bogie])
            numbers = piece.numbers
            change[numbers] += piece.run.facing * piece.weight * (own.conj() * piece.ahead_of).sum(axis=1)
            weight[numbers] += piece.weight * (np.abs(own) ** 2).sum(axis=0)
            power += piece.weight * (np.abs(piece.ahead_of) ** 2).sum(axis=(0, 1))
            count += 2 * len(numbers)
        weight += BOGIE_TRACK.response_floor
        return change / weight, power / max(count, 1) / weight

    def solved(self, bend_std: float) -> _Solved:
        """Return the unknowns of all bogies, with bends of their curves of a std, m, and d with them."""
        u, m = len(self.reached[0].theta), len(band())
        size = u * len(self.known)
        whole, wanted = np.zeros((size, size)), np.zeros(size)
        by_instruments, by_columns = np.zeros((2, self.segments, m, size), dtype=np.complex128)
        left_over, weight = np.zeros((self.segments, m), dtype=np.complex128), np.zeros((self.segments, m))
        for bogie, (known, reached) in enumerate(zip(self.known, self.reached, strict=True)):
            own = slice(bogie * u, (bogie + 1) * u)
            held = replace(known, stds=BOGIE_TRACK.held * known.stds)
            whole[own, own], wanted[own] = reached.expected(held, bend_std)
            pieces = [piece for piece in self.pieces if piece.bogie == bogie]
            errors = error_spectrum([piece.spectra for piece in pieces], reached.theta)
            inverse = np.linalg.inv(errors.covariance)
            for piece, scale in zip(pieces, errors.scale, strict=True):
                left, right = normal(piece.spectra, errors.covariance, scale)
                whole[own, own] += left
                wanted[own] -= right
                by_d = _column_of_d(piece, known)
                white = np.einsum("mef,fm->em", inverse, by_d)
                for row, number in enumerate(piece.numbers):
                    measured, simulated = (
                        side.dense(row, piece.spectra.axles)
                        for side in (piece.spectra.measured, piece.spectra.simulated)
                    )
                    by_instruments[number, :, own] += np.einsum("eum,em->mu", simulated.conj(), white) / scale[row]
                    left_over[number] += np.einsum("em,em->m", white.conj(), piece.spectra.target[row]) / scale[row]
                    by_columns[number, :, own] += np.einsum("em,eum->mu", white.conj(), measured) / scale[row]
                    weight[number] += np.einsum("em,em->m", by_d.conj(), white).real / scale[row]
        weight += 1.0 / (TAPERED * segment_cells() * BOGIE_TRACK.wave_std**2)
        eliminated = (by_instruments / weight[..., None]).reshape(-1, size)
        whole -= (eliminated.T @ by_columns.reshape(-1, size)).real
        wanted += (eliminated.T @ left_over.ravel()).real
        theta = np.linalg.solve(whole, wanted)
        waves, columns = -(left_over + by_columns @ theta) / weight, by_columns / weight[..., None]
        return _Solved(np.split(theta, len(self.known)), waves, whole, columns, weight)


def _column_of_d(piece: _Piece, known: Beforehand) -> ComplexArray:
    """Return what the three equations (3, m) change by per d, of waves that are measured."""
    behind = _behind(piece.run.onward * known.gear.bogie.wheelbase)
    found = np.zeros((3, len(band())), dtype=np.complex128)
    found[0], found[1] = -piece.run.facing * piece.slope[0], -piece.run.facing * piece.slope[1] * behind
    return np.asarray(found * ~_simulated_waves())


def _behind(distance: float | FloatArray) -> ComplexArray:
    """Return what waves (m,) at a place are times further along the section, by a distance, m."""
    return np.asarray(np.exp(-2j * np.pi * band() / BOGIE.segment_m * distance))


def _simulated_waves() -> np.ndarray:
    return band() / BOGIE.segment_m < 1.0 / BOGIE.carried_wave


def _section(
    known: Sequence[Beforehand], reached: Sequence[Reached], d: FloatArray, runs: Sequence[BogieAndRun]
) -> _Section | None:
    at, pieces = BOGIE.grid_step * (np.arange(len(d)) + 0.5), []
    for bogie, run in runs:
        piece = _piece(bogie, run.over(run.facing * np.interp(run.place, at, d)), reached[bogie])
        if piece is None:
            return None
        pieces.append(piece)
    return _Section(known, reached, d, pieces)


@dataclass(frozen=True, slots=True)
class _Step:
    """What a round changes, without the spectra that say so."""

    known: Sequence[Beforehand]
    reached: Sequence[Reached]
    d: FloatArray  # (n,) m
    runs: Sequence[BogieAndRun]
    theta: Sequence[FloatArray]  # by bogie; none where curves stay
    change: FloatArray  # (n,) m, of d

    def taken(self) -> _Section | None:
        """Return the section after it; what derails is halved. None where it still does."""
        if not self.theta:
            return _section(self.known, self.reached, self.d + self.change, self.runs)
        blend = BOGIE.blend
        for _ in range(BOGIE.halvings):
            reached = [one.towards(own, blend) for one, own in zip(self.reached, self.theta, strict=True)]
            section = _section(self.known, reached, self.d + blend * self.change, self.runs)
            if section is not None:
                return section
            blend *= 0.5
        return None


def _along(waves: ComplexArray, points: int) -> FloatArray:
    """Return d (n,), m, of its waves in segments (g, m)."""
    size = segment_cells()
    found, spectrum = np.zeros(points), np.zeros(size // 2 + 1, dtype=np.complex128)
    for number, own in enumerate(waves):
        spectrum[band()] = own
        found[number * size // 2 : number * size // 2 + size] += np.fft.irfft(spectrum, size)
    return found


def alignment_of_bogies(
    known: Sequence[Beforehand],
    runs: Sequence[BogieAndRun],
    length: float,
    checkpoint: Callable[[int, int], None] = lambda _done, _of: None,
) -> FoundAlignment | Reason:
    """Return the alignment that explains the runs of bogies over a section, or why there is none.

    Args:
        known: What is known of each bogie beforehand.
        runs: Each with the number of its bogie, over any alignment.
        length: Of the section, m.
    """
    hop = segment_cells() // 2
    points = hop * int(length / BOGIE.grid_step / hop)
    straight = [Reached.at_first(one, Curves.straight(BOGIE.start_conicity)) for one in known]
    with np.errstate(invalid="ignore"):  # nothing is like a bogie at rest
        section = _section(known, straight, np.zeros(points), runs) if points > hop else None
    for number in range(BOGIE_TRACK.start_rounds):
        if section is None:
            break
        response = section.response() if number else np.ones((len(known), 2, len(band())), dtype=np.complex128)
        share = 1.0 if number else BOGIE_TRACK.start_share  # y itself is no alignment, but shows the response
        first = _Step(
            known, straight, section.d, section.runs(), [], share * _along(section.by_motion(response)[0], points)
        )
        section = None  # there is no memory for the spectra of both
        section = first.taken()
    moved = np.zeros(points)
    for number, bend_std in enumerate(BOGIE_TRACK.bend_stds):
        if section is None:
            break
        checkpoint(number, len(BOGIE_TRACK.bend_stds))
        step, moved = _step(section, bend_std)
        section = None
        section = step.taken()
    if section is None:
        return Reason(ReasonCode.STIFFNESS_OPEN, "bogies with the curves that are found do not stay on their track")
    return _found(section, moved, runs)


def _step(section: _Section, bend_std: float) -> tuple[_Step, FloatArray]:
    """Return the next step, and what of it is known by the equations."""
    solved = section.solved(bend_std)
    long_waves, _ = section.by_motion(section.response())
    change = _along(np.where(_simulated_waves(), long_waves, solved.waves), len(section.d))
    step = _Step(section.known, section.reached, section.d, section.runs(), solved.theta, change)
    return step, _along(np.where(_simulated_waves(), 0.0, solved.waves), len(section.d))


def _found(section: _Section, moved: FloatArray, runs: Sequence[BogieAndRun]) -> FoundAlignment:
    size, points = segment_cells(), len(section.d)
    response = section.response()
    wheelbases = np.array([known.gear.bogie.wheelbase for known in section.known])
    response[:, 1] *= _behind(-wheelbases[:, None])
    unfollowed = (np.abs(response - 1.0) ** 2).mean(axis=(0, 1))
    measured = section.solved(BOGIE_TRACK.bend_stds[-1]).variance()
    simulated = unfollowed * section.by_motion(section.response())[1]
    of_segments = np.where(_simulated_waves(), simulated, measured).sum(axis=1) * 2.0 / size**2 / TAPERED
    passed = np.zeros(section.segments)
    for piece in section.pieces:
        passed[piece.numbers] += 1.0
    of_segments = BOGIE_TRACK.std_factor**2 * of_segments + BOGIE_TRACK.own_std**2
    # a place is known by the two segments that it is in
    runs_at, variance = np.zeros((2, points // (size // 2)))
    runs_at[1:-1] = [min(pair) for pair in itertools.pairwise(passed)]
    variance[1:-1] = [0.5 * sum(pair) for pair in itertools.pairwise(of_segments)]
    each = np.repeat(runs_at, size // 2)
    certain = each >= BOGIE_TRACK.fewest_runs
    shift = [float((piece.run.place - run.place)[0, -1]) for piece, (_, run) in zip(section.pieces, runs, strict=True)]
    return FoundAlignment(
        place=np.asarray(BOGIE.grid_step * (np.arange(points) + 0.5)),
        alignment=np.where(certain, section.d, np.nan),
        std=np.where(certain, np.sqrt(np.repeat(variance, size // 2)), np.nan),
        runs=each,
        shift=np.array(shift),
        moved=float(np.sqrt(np.mean(moved[certain] ** 2))) if certain.any() else float("inf"),
    )
