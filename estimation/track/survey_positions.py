"""Positions of journeys on a survey, from the regression of R on y - d (``docs/decisions/positions-on-a-survey.md``).

With g the curve of a wheelset, at the true offset a and scale error b of its journey

    R(s) = g(y(s) - d(s + a + b (s - middle))) + noise

and nearly all noise is in R. The other way round, with R as the regressor, it would flatten the curves, and move all
journeys. Curves, offsets and scale errors of a vehicle are solved for together (Gauss-Newton), from short waves alone:
they know the place best, and the noise of R is in the long ones.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from estimation.filters import high_pass, local_cubic_kernel, valid_support
from estimation.track.gridded_pass import Placed, PlacedJourney, SectionGrid
from estimation.track.panel.basis import basis_functions, knot_shares
from estimation.track.panel.solution import PriorAlignment
from estimation.track.passes import Journey, ProfileLife
from estimation.track.positions import compose
from estimation.values.arrays import BoolArray, FloatArray
from estimation.values.track import Correction


@dataclass(frozen=True, slots=True)
class SurveyPositionParameters:
    """How positions on a survey are searched."""

    cutoff_wavelength: float = 15.0  # m, of what is compared
    knots: FloatArray = field(
        default_factory=lambda: np.asarray(np.arange(-12, 13) * 0.5e-3, dtype=np.float64)
    )  # m of y - d, of the curves
    rounds: int = 12
    tolerance: float = 0.02  # m: offsets that move less are found
    largest_step: float = 2.0  # m a round
    farthest: float = 3.0  # m from where a journey was, on its way: beyond is another wave of the track
    place_std: float = 1.0  # m, of where the panel has put a journey: where short waves say nothing, it stays
    correlated: float = 4.0  # m, over which the errors of short waves are one
    scale_std: float = 3e-3  # of an odometer, known beforehand
    ridge: float = 1e-6  # of the curves' mean square: knots that no sample reaches
    least_points: int = 400  # of a journey; fewer say nothing of its place
    most_apart: float = 2.0  # rms of y - d over that of y: a survey in another unit is no survey to be placed on


def positions_on_survey(placed: Placed, survey: PriorAlignment, grid: SectionGrid) -> dict[Journey, Correction] | None:
    """Return corrections of all journeys, placed within metres, on a survey; None where none of a vehicle is found."""
    corrections = {journey: where.correction for journey, where in placed.items()}
    vehicles = 0
    for vehicle in sorted({journey[0] for journey in placed}):
        members = {journey: where for journey, where in placed.items() if journey[0] == vehicle}
        on_survey = _Vehicle.of(members, survey, grid)
        moved = on_survey.moves() if on_survey.of_one_size() else None
        if moved is None:
            continue  # it keeps its places
        vehicles += 1
        middle = 0.5 * grid.length
        for (journey, where), (offset, scale) in zip(members.items(), moved.tolist(), strict=True):
            corrections[journey] = compose(where.correction, Correction(offset, scale, middle))
    return corrections if vehicles else None


@dataclass(frozen=True, slots=True)
class _PassOnSurvey:
    journey: int
    life: int
    at: FloatArray  # m, along the section
    displacement: FloatArray  # y, m, high-passed
    difference: FloatArray  # R with the sign of the section, m, short waves
    used: BoolArray


@dataclass(frozen=True, slots=True)
class _Vehicle:
    passes: Sequence[_PassOnSurvey]
    journeys: int
    lives: int
    survey: PriorAlignment
    grid: SectionGrid
    kernel: FloatArray
    parameters: SurveyPositionParameters

    @classmethod
    def of(cls, members: Mapping[Journey, PlacedJourney], survey: PriorAlignment, grid: SectionGrid) -> _Vehicle:
        p = SurveyPositionParameters()
        kernel = local_cubic_kernel(p.cutoff_wavelength, grid.step)
        lives: dict[ProfileLife, int] = {}
        covered = np.isfinite(survey.std)
        passes = []
        for number, item in ((k, item) for k, where in enumerate(members.values()) for item in where.passes):
            if item.empty:
                continue
            on = item.inside.copy()
            on[item.inside] &= covered[item.used_points]
            place = np.asarray(item.points * grid.step, dtype=np.float64)
            y, R = high_pass(item.displacement, grid.kernel), high_pass(item.side * item.difference, kernel)
            life = lives.setdefault(item.life, len(lives))
            passes.append(_PassOnSurvey(number, life, place, y, R, valid_support(on, kernel)))
        return cls(passes, len(members), len(lives), survey, grid, kernel, p)

    def of_one_size(self) -> bool:
        """Whether the survey is not far larger than what the passes have measured."""
        apart, square = 0.0, 0.0
        for window_pass in self.passes:
            y = window_pass.displacement[window_pass.used]
            rest, _ = _displaced(window_pass, np.zeros(2), self.survey, self.grid)
            apart, square = apart + float(rest[window_pass.used] @ rest[window_pass.used]), square + float(y @ y)
        return apart <= self.parameters.most_apart**2 * square

    def moves(self) -> FloatArray | None:
        """Return by how much each journey is to be moved (j, 2): offset, m, and scale; None where that is not found."""
        p = self.parameters
        counts = np.zeros(self.journeys)
        for window_pass in self.passes:
            counts[window_pass.journey] += float(window_pass.used.sum())
        enough = counts >= p.least_points
        moves = np.zeros((self.journeys, 2))
        if not enough.any():
            return moves
        for _ in range(p.rounds):
            steps = np.where(enough[:, None], self._steps(moves), 0.0)
            if not np.isfinite(steps).all():
                return None
            largest = float(np.max(np.abs(steps[:, 0]), initial=0.0))
            moves = moves + steps * min(1.0, p.largest_step / max(largest, p.largest_step))
            if largest < p.tolerance:
                middles = [float(np.mean(item.at)) - 0.5 * self.grid.length for item in self.passes]
                moved = [moves[item.journey] @ [1.0, middle] for item, middle in zip(self.passes, middles, strict=True)]
                return moves if float(np.max(np.abs(moved), initial=0.0)) <= p.farthest else None
        return None

    def _steps(self, moves: FloatArray) -> FloatArray:
        p = self.parameters
        k, curves = len(p.knots), len(p.knots) * self.lives
        moved = [_displaced(item, moves[item.journey], self.survey, self.grid) for item in self.passes]
        columns = [
            high_pass(basis_functions(np.clip(x, p.knots[0], p.knots[-1]), p.knots), self.kernel)[:, item.used]
            for item, (x, _) in zip(self.passes, moved, strict=True)
        ]
        slopes, weights = self._curves(columns)
        unknowns = curves + 2 * self.journeys
        normal, right = np.zeros((unknowns, unknowns)), np.zeros(unknowns)
        for item, of_knots, (x, slope_of_survey) in zip(self.passes, columns, moved, strict=True):
            by_offset = -slopes[item.life][knot_shares(x, p.knots)[0]] * slope_of_survey
            by_move = np.stack([by_offset, by_offset * (item.at - 0.5 * self.grid.length)])
            design = np.concatenate([of_knots, high_pass(by_move, self.kernel)[:, item.used]])
            index = np.append(np.arange(k) + k * item.life, curves + 2 * item.journey + np.arange(2))
            normal[np.ix_(index, index)] += weights[item.life] * (design @ design.T)
            right[index] += weights[item.life] * (design @ item.difference[item.used])
        extra = np.full(unknowns, p.ridge * float(np.trace(normal[:curves, :curves])) / curves + 1e-30)
        place = p.correlated / self.grid.step / p.place_std**2
        extra[curves:] = np.tile([place, 1.0 / p.scale_std**2], self.journeys)
        right[curves::2] -= place * moves[:, 0]
        return np.asarray(np.linalg.solve(normal + np.diag(extra), right)[curves:].reshape(self.journeys, 2))

    def _curves(self, columns: Sequence[FloatArray]) -> tuple[FloatArray, FloatArray]:
        """Return the slopes of the curves where the journeys are now (w, k - 1), and the weights of their samples (w,).

        A weight is one over the variance of what the curve leaves.
        """
        p = self.parameters
        slopes, weights = np.zeros((self.lives, len(p.knots) - 1)), np.ones(self.lives)
        for life in range(self.lives):
            pairs = zip(self.passes, columns, strict=True)
            rows = [(part, item.difference[item.used]) for item, part in pairs if item.life == life]
            normal = np.sum([part @ part.T for part, _ in rows], axis=0)
            right = np.sum([part @ target for part, target in rows], axis=0)
            square = float(sum(target @ target for _, target in rows))
            ridge = p.ridge * float(np.trace(normal)) / len(p.knots) + 1e-30
            curve = np.linalg.solve(normal + ridge * np.eye(len(p.knots)), right)
            rest = max(square - float(curve @ right), 1e-6 * square)
            slopes[life] = np.diff(curve) / np.diff(p.knots)
            weights[life] = sum(len(target) for _, target in rows) / max(rest, 1e-30)
        return slopes, weights


def _displaced(
    item: _PassOnSurvey, move: FloatArray, survey: PriorAlignment, grid: SectionGrid
) -> tuple[FloatArray, FloatArray]:
    moved = item.at + move[0] + move[1] * (item.at - 0.5 * grid.length)
    slope = np.gradient(survey.alignment, grid.step)
    return item.displacement - np.interp(moved, grid.s, survey.alignment), np.interp(moved, grid.s, slope)
