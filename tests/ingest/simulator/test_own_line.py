"""The page for a newcomer's own line and wheels: its scenario is good, with files like those it asks for."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from bench.wheelset_motion import wheelset_motion
from estimation.contact.profiles import wheel_profile
from estimation.contact.wear import TreadWear, worn
from ingest.registry_file import read_registry
from ingest.simulator.campaign import scenario_track, vehicle_run
from ingest.simulator.fleet import prepare
from ingest.simulator.scenario_file import read_scenario

PAGE = Path(__file__).parents[3] / "docs" / "own-line.md"


def own_files(folder: Path) -> None:
    s = np.arange(0.0, 4000.25, 0.25)
    alignment, gauge = 2.0 * np.sin(s / 6.0) * np.sin(s / 90.0), 1.0 + 1.5 * np.sin(s / 60.0)
    table = np.column_stack([s + 31_000.0, alignment, gauge])
    header = "s_m,alignment_mm,gauge_deviation_mm"
    np.savetxt(folder / "line.csv", table, fmt="%.4f", delimiter=",", header=header, comments="")
    for name, depth in (("left.whl", 0.6e-3), ("right.whl", 0.45e-3)):
        wheel = worn(wheel_profile("P8"), TreadWear(depth, 3e-3, 44e-3, depth))
        y = np.arange(-69.9, 60.0, 0.25)
        points = "\n".join(f"{a + 70:.4f} {1e3 * z:.4f}" for a, z in zip(y, wheel.height(1e-3 * y), strict=True))
        (folder / name).write_text(f"ProgramName=MiniProf\nXYPoints={len(y)}\nColumnDef=X,Y\n\n{points}\n")


def test_the_scenario_of_the_page_runs_with_a_line_and_two_wheels(tmp_path: Path) -> None:
    own_files(tmp_path)
    example = re.search(r"```toml\n(.*?)```", PAGE.read_text(), re.DOTALL)
    assert example is not None
    (tmp_path / "mine.toml").write_text(example[1])
    scenario = read_scenario(tmp_path / "mine.toml")
    track, vehicle = scenario_track(scenario), scenario.vehicles[0]
    (known,) = read_registry(prepare(scenario, tmp_path / "simulated")).alignments
    assert known.gauge_deviation.std() > 1e-3
    motion = wheelset_motion(scenario, track, vehicle_run(scenario, track, vehicle, 0), 0)
    assert motion.outside == 0
    assert motion.distance[-1] - motion.distance[0] > 2000.0
