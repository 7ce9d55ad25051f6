"""What the fleets of the signature bench run, seed by seed, and the regressions that they are compared with."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bench.signature_cases import (
    DAY_NS,
    LENGTH,
    Foreign,
    Pass,
    Simulated,
    SimulatedFleet,
    Wheelset,
    on_a_vehicle,
    run,
    run_within,
    tracks,
    wheelsets,
)
from estimation.contact.geometry import WheelsetOnTrack
from estimation.contact.profiles import Profile, rail_profile, wheel_profile
from estimation.contact.wear import RailWear, TreadWear, WearFamily, wear_course, worn, worn_rail
from estimation.signatures.mixed_model import features_of
from estimation.signatures.window_signatures import SignatureParameters
from estimation.values.arrays import FloatArray
from estimation.values.signatures import Place
from ingest.simulator.track import TrackRecipe, TrackTruth, make_track

KINDS_FOREIGN = {  # how many of each a seed has
    "S1002 on 60E1": 8,
    "S1002 on 56E1": 3,
    "P8 on 60E1": 3,
    "P8 on worn rails": 3,
    "P8 with a narrow hollow": 3,
    "P8 with a thin flange": 3,
    "P8, one wheel less worn": 3,
    "P8 at another gauge": 3,
}
GAUGE = 1.435  # m
DEEPEST = {WearFamily.P8_ON_56E1: 1.5e-3, WearFamily.S1002_ON_60E1: 1.3e-3}  # m
FOREIGN_SPEEDS = (14.5, 19.5)  # m/s


def foreign(known: Mapping[str, TrackTruth], unknown: Mapping[str, TrackTruth], seed: int) -> tuple[Foreign, ...]:
    """Return passes of them, each over a section that the library has and over one that it does not have."""
    rng = np.random.default_rng([seed, 41])
    found = []
    for kind, count in KINDS_FOREIGN.items():
        for number in range(count):
            runs = on_a_vehicle(f"X {kind} {number}", 0, _on_track(kind, rng), rng)
            for rails in (known, unknown):
                section = sorted(rails)[int(rng.integers(len(rails)))]
                try:
                    made = run_within(runs, section, rails[section], FOREIGN_SPEEDS, rng)
                except RuntimeError:  # it left its contact table, or its window is refused
                    found.append(Foreign(kind, None))
                else:
                    found.append(Foreign(kind, made))
    return tuple(found)


def _on_track(kind: str, rng: np.random.Generator) -> WheelsetOnTrack:
    family = WearFamily.S1002_ON_60E1 if kind.startswith("S1002") else WearFamily.P8_ON_56E1
    left = right = wear_course(family, float(rng.uniform(0.0, DEEPEST[family])))
    rail, inclination, gauge = rail_profile("60E1" if kind.endswith("60E1") else "56E1"), 1 / 20, GAUGE
    match kind:
        case "S1002 on 60E1":
            inclination = 1 / 40
        case "P8 on worn rails":
            worn_away = RailWear(rng.uniform(0.5e-3, 2e-3), rng.uniform(-0.02, 0.0), rng.uniform(0.02, 0.03))
            rail = worn_rail(rail, worn_away)
        case "P8 with a narrow hollow":
            left = right = TreadWear(
                rng.uniform(0.3e-3, 1.5e-3), rng.uniform(-4e-3, 10e-3), rng.uniform(22e-3, 32e-3), 0.0
            )
        case "P8 with a thin flange":
            left = right = replace(left, flange_wear=rng.uniform(1.5e-3, 4e-3))
        case "P8, one wheel less worn":
            depth = rng.uniform(0.6e-3, 1.5e-3)
            left, right = (wear_course(family, depth * share) for share in (1.0, rng.uniform(0.0, 0.4)))
        case "P8 at another gauge":
            gauge += rng.choice([-1.0, 1.0]) * rng.uniform(2e-3, 5e-3)
    wheel: Profile = wheel_profile("S1002" if family is WearFamily.S1002_ON_60E1 else "P8")
    return WheelsetOnTrack(worn(wheel, left), worn(wheel, right), rail, rail, inclination, gauge)


@dataclass(frozen=True, slots=True)
class Plan:
    """What a fleet of one seed runs."""

    teachers: int = 28
    judged: int = 14
    sections: int = 6
    others: int = 3  # sections that the library does not have
    speeds: tuple[tuple[float, float], ...] = ((14.0, 20.0),)  # of the library, m/s, one range a run
    asked: tuple[float, float] = (14.0, 20.0)  # of the judged wheelsets


def fleet(plan: Plan, seed: int) -> SimulatedFleet:
    """Run a fleet."""
    rng = np.random.default_rng([seed, 77])
    known, unknown = tracks(plan.sections, seed), tracks(plan.others, seed, plan.sections)

    def passes(
        who: Sequence[Wheelset], where: dict[str, TrackTruth], ranges: Sequence[tuple[float, float]]
    ) -> list[Pass]:
        return [
            run_within(one, code, track, limits, rng)
            for one in who
            for code, track in where.items()
            for limits in ranges
        ]

    teachers, asked = wheelsets(plan.teachers, "T", rng), wheelsets(plan.judged, "J", rng)
    return SimulatedFleet(
        tuple(passes(teachers, known, plan.speeds)),
        tuple(passes(asked, dict(list(known.items())[: plan.others]), [plan.asked])),
        tuple(passes(asked, unknown, [plan.asked])),
        known,
    )


TAMPED_FROM = 1500.0  # m of a section, from where on its track is another


def retracked(made: SimulatedFleet, seed: int, count: int = 14) -> tuple[list[Pass], set[Place]]:
    """Return passes over two sections before and after half of one was tamped, and the stretches that were.

    The first runs are those of the library; the second are a year later.
    """
    rng = np.random.default_rng([seed, 31])
    code, other = list(made.tracks)[:2]
    track = made.tracks[code]
    fresh = make_track(TrackRecipe(length=LENGTH, alignment_std=0.9e-3), np.random.SeedSequence([seed, 32]))
    share = np.clip((track.s - TAMPED_FROM) / 50.0, 0.0, 1.0)
    tamped = replace(track, alignment=(1 - share) * track.alignment + share * fresh.alignment)
    runs = list({one.wheelset.serial: one.wheelset for one in made.teaching}.values())[:count]
    serials = {one.serial for one in runs}
    passes = [one for one in made.teaching if one.section in {code, other} and one.wheelset.serial in serials]
    for number, runner in enumerate(runs):
        for section, rails in ((code, tamped), (other, made.tracks[other])):
            at_ns = (365 + number) * DAY_NS
            passes.append(run(runner, section, rails, float(rng.uniform(14, 20)), rng, at_ns))
    places = {item.place for one in passes for item in one.signatures if item.place is not None}
    size = SignatureParameters().cell
    return passes, {one for one in places if one.section == code and one.cell * size >= TAMPED_FROM}


SPEEDS = Plan(sections=3, others=2, teachers=21, judged=7, speeds=((14.0, 16.0), (18.0, 20.0)), asked=(16.5, 17.5))


def simulated(seed: int) -> Simulated:
    """Return the passes of a seed."""
    made = fleet(Plan(), seed)
    others = foreign(made.tracks, tracks(Plan().others, seed, Plan().sections), seed)
    passes, tamped = retracked(made, seed)
    return Simulated(made, fleet(SPEEDS, seed), others, tuple(passes), frozenset(tamped))


PENALTIES = 10.0 ** np.arange(-3, 4)
LENGTHS = np.array([2.0, 4.0, 8.0, 16.0])  # of the process, in standard deviations of a feature
NOISES = np.array([1e-3, 1e-2, 1e-1])  # over the variance of the conicity


@dataclass(frozen=True, slots=True)
class Regression:
    """A kernel regression of conicity on features: with a linear kernel a ridge, with that of Gauss a process."""

    middle: FloatArray
    scale: FloatArray
    support: FloatArray  # (n, f)
    weights: FloatArray  # (n,)
    mean: float
    length: float | None  # None: linear

    def of(self, one: Pass) -> float:
        """Return the conicity of a pass: the mean over its stretches."""
        x = (_inputs([one]) - self.middle) / self.scale
        return self.mean + float(np.mean(_kernel(x, self.support, self.length) @ self.weights))


def _inputs(passes: Sequence[Pass]) -> FloatArray:
    powers = np.stack([one.powers for item in passes for one in item.signatures])
    speed = np.array([one.speed for item in passes for one in item.signatures])
    return np.column_stack([features_of(powers), np.log(speed)])


def _kernel(a: FloatArray, b: FloatArray, length: float | None) -> FloatArray:
    if length is None:
        return np.asarray(a @ b.T)
    squared = np.sum(a**2, 1)[:, None] + np.sum(b**2, 1)[None] - 2 * a @ b.T
    return np.asarray(np.exp(-0.5 * squared / (length**2 * a.shape[1] / 8)))


def trained(passes: Sequence[Pass], conicity: Sequence[float], *, linear: bool) -> Regression:
    """Return the regression whose errors are least where wheelsets are left out, a sixth of them at a time."""
    x = _inputs(passes)
    y = np.concatenate([np.full(len(one.signatures), c) for one, c in zip(passes, conicity, strict=True)])
    names = np.concatenate([np.full(len(one.signatures), one.wheelset.serial) for one in passes])
    middle, scale, mean = x.mean(axis=0), x.std(axis=0), float(y.mean())
    z = (x - middle) / scale
    folds = [np.isin(names, np.unique(names)[k::6]) for k in range(6)]
    options: list[tuple[float | None, float]] = [(None, float(penalty)) for penalty in PENALTIES]
    if not linear:
        options = [(float(length), float(noise)) for length in LENGTHS for noise in NOISES]
    errors = []
    for length, penalty in options:
        K = _kernel(z, z, length)
        errors.append(sum(_error(K, y - mean, penalty, out) for out in folds))
    length, penalty = options[int(np.argmin(errors))]
    weights = np.linalg.solve(_kernel(z, z, length) + penalty * np.eye(len(z)), y - mean)
    return Regression(middle, scale, z, weights, mean, length)


def _error(K: FloatArray, y: FloatArray, penalty: float, out: np.ndarray[tuple[int], np.dtype[np.bool_]]) -> float:
    weights = np.linalg.solve(K[np.ix_(~out, ~out)] + penalty * np.eye(int((~out).sum())), y[~out])
    return float(np.sum((K[np.ix_(out, ~out)] @ weights - y[out]) ** 2))
