"""Wheels and rails that no library of the bench has, though the registry says so: refused, or covered.

Library and registry know P8 wheels, worn alike on both sides, on new 56E1 rails at 1435 mm. The wheels here are others,
or run on others.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from bench.signature_cases import Foreign, on_a_vehicle, run_within
from estimation.contact.geometry import WheelsetOnTrack
from estimation.contact.profiles import Profile, rail_profile, wheel_profile
from estimation.contact.wear import RailWear, TreadWear, WearFamily, wear_course, worn, worn_rail
from ingest.simulator.track import TrackTruth

KINDS = {  # how many of each a seed has
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
SPEEDS = (14.5, 19.5)  # m/s


def foreign(known: Mapping[str, TrackTruth], unknown: Mapping[str, TrackTruth], seed: int) -> tuple[Foreign, ...]:
    """Return passes of them, each over a section that the library has and over one that it does not have."""
    rng = np.random.default_rng([seed, 41])
    found = []
    for kind, count in KINDS.items():
        for number in range(count):
            runs = on_a_vehicle(f"X {kind} {number}", 0, _on_track(kind, rng), rng)
            for tracks in (known, unknown):
                section = sorted(tracks)[int(rng.integers(len(tracks)))]
                try:
                    made = run_within(runs, section, tracks[section], SPEEDS, rng)
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
