"""What the fleets of the signature bench run, seed by seed, and passes that are kept from one bench to the next."""

from __future__ import annotations

import pickle
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from bench.signature_cases import LENGTH, Pass, Simulated, SimulatedFleet, Wheelset, run, run_within, tracks, wheelsets
from bench.signature_foreign import foreign
from estimation.signatures.window_signatures import SignatureParameters
from estimation.values.signatures import Place
from estimation.values.units import DAY_NS
from ingest.simulator.track import TrackRecipe, TrackTruth, make_track


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


def simulated(seed: int, folder: Path | None = None) -> Simulated:
    """Return the passes of a seed: from ``folder`` where it has them, else simulated, and kept there."""
    file = None if folder is None else folder / f"signatures-{seed}.pickle"
    if file is not None and file.exists():
        kept: Simulated = pickle.loads(file.read_bytes())  # noqa: S301 - written by the lines below
        return kept
    made = fleet(Plan(), seed)
    others = foreign(made.tracks, tracks(Plan().others, seed, Plan().sections), seed)
    passes, tamped = retracked(made, seed)
    found = Simulated(_bare(made), _bare(fleet(SPEEDS, seed)), others, tuple(passes), frozenset(tamped))
    if file is not None:
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(pickle.dumps(found))
    return found


def _bare(made: SimulatedFleet) -> SimulatedFleet:
    """Return a fleet without its tracks, which are large."""
    return replace(made, tracks={})
