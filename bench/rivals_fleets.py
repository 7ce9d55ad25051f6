"""Two fleets for estimators: smooth wheels, whose R(y - d) is a smooth curve, and P8 on 113A, whose R has jumps."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from estimation.contact.profiles import wheel_profile
from ingest.simulator.drawn_fleet import with_seed
from ingest.simulator.drawn_plan import ProfilePair
from ingest.simulator.scenario import Scenario
from ingest.simulator.scenario_file import load_scenario

SMOOTH, JUMPS = "smooth", "P8/113A"
FAMILIES = (SMOOTH, JUMPS)
STEP = 0.005e-3  # m between points of contact tables: contact jumps are where the profiles have them
ROOT = -33.0  # mm, in the flange: a corner, where no tread is
STEEPNESS = (0.06, 0.16)  # of the treads, from the first wheelset to the last
CUBIC = 300e-6  # 1/mm2, by which treads are steeper towards the flange
ON_TREAD = 8.0  # mm from the datum to either side, within which the tread is cubic; straight beyond


def fleet(family: str, seed: int, vehicles: int, wheels: Path) -> Scenario:
    """Return the fleet of the accuracy table, on known track, with the wheels of a family.

    Args:
        family: One of ``FAMILIES``.
    """
    scenario = load_scenario("known")
    drawn = scenario.drawn
    assert drawn is not None  # the built-in scenario draws its fleet
    pair = next(item for item in drawn.pairs if item.name == JUMPS)
    if family == SMOOTH:
        pair = _smooth_pair(pair, 4 * vehicles, wheels)
    plan = replace(drawn, given_vehicles=vehicles, pairs=(pair,))
    running = replace(scenario.running, contact_step=STEP)
    return with_seed(replace(scenario, name=f"rivals {family}", drawn=plan, running=running), seed)


def _smooth_pair(pair: ProfilePair, wheelsets: int, folder: Path) -> ProfilePair:
    """Return smooth wheels, one pair of files a wheelset, on the rail of ``pair``."""
    folder.mkdir(parents=True, exist_ok=True)
    files = []
    for rank, steepness in enumerate(np.linspace(*STEEPNESS, wheelsets)):
        path = folder / f"smooth-{rank}-of-{wheelsets}.whl"
        path.write_text(_wheel(float(steepness)), encoding="ascii")
        files.append((path, path))
    return replace(pair, name="smooth", deepest_wear=0.0, wheel_files=tuple(files))


def _wheel(steepness: float) -> str:
    """Return a wheel as a MiniProf file: the flange of a P8, and a tread without any edge."""
    y = np.arange(-69.9, 60.0, 0.25)
    flange = 1e3 * wheel_profile("P8").height(1e-3 * y)
    near = np.clip(y, -ON_TREAD, ON_TREAD)
    fall = steepness * y + CUBIC / 3.0 * near**3 + CUBIC * ON_TREAD**2 * (y - near)
    root = float(np.interp(ROOT, y, flange)) + float(np.interp(ROOT, y, fall))
    z = np.where(y > ROOT, root - fall, flange)
    rows = "\n".join(f"{a + 70:.4f} {b:.6f}" for a, b in zip(y, z, strict=True))
    return f"ProgramName=MiniProf\nXYPoints={len(y)}\nColumnDef=X,Y\n\n{rows}\n"
