"""Flats and blows of the track: on their wheelset, once a turn, from their campaign on, and at their places."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scenario_text import SMALL

from bench.wheelset_motion import wheelset_motion
from estimation.errors import InputError
from estimation.values.arrays import FloatArray
from ingest.simulator.campaign import _with_blows, scenario_track, vehicle_run
from ingest.simulator.running import blow
from ingest.simulator.scenario import Scenario
from ingest.simulator.scenario_file import load_scenario, read_scenario

FLAT = """
[[wheels.flats]]
wheelset = "{serial}"
wheel = "{wheel}"
blow_m_s2 = 30.0
from_campaign = {campaign}
"""


def scenario_with(folder: Path, text: str) -> Scenario:
    path = folder / "scenario.toml"
    path.write_text(SMALL + text, encoding="utf-8")
    return read_scenario(path)


def blows_of(scenario: Scenario, campaign: int, axle: int) -> tuple[FloatArray, FloatArray]:
    """Return what blows add (4, n), and the distance of the wheelset (n,)."""
    track = scenario_track(scenario)
    run = vehicle_run(scenario, track, scenario.vehicles[0], campaign)
    motion = wheelset_motion(scenario, track, run, axle)
    struck = _with_blows(scenario, run, axle, motion).path_accelerations
    before = np.zeros((4, len(motion))) if motion.path_accelerations is None else motion.path_accelerations
    return np.zeros((4, len(motion))) if struck is None else struck - before, motion.distance


def serial(scenario: Scenario, axle: int) -> str:
    return scenario.vehicles[0].wheelsets[axle].serial


def test_a_blow_leaves_no_velocity() -> None:
    assert blow().sum() == pytest.approx(0.0, abs=1e-12)
    assert blow().max() == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize(("wheel", "sign"), [("left", -1.0), ("right", 1.0)])
def test_a_flat_strikes_its_wheelset_once_a_turn(tmp_path: Path, wheel: str, sign: float) -> None:
    plain = scenario_with(tmp_path, "")
    flat = scenario_with(tmp_path, FLAT.format(serial=serial(plain, 0), wheel=wheel, campaign=2))
    added, distance = blows_of(flat, 1, 0)
    peaks = np.flatnonzero((sign * added[0] > 10.0) & (np.diff(sign * added[0] > 10.0, prepend=False)))
    turn = 2.0 * np.pi * flat.vehicles[0].wheelsets[0].nominal_radius
    assert np.diff(distance[peaks]) == pytest.approx(turn, abs=0.06)
    assert np.all(sign * added[2][peaks] < 0.0)
    assert not blows_of(flat, 0, 0)[0].any()
    assert not blows_of(flat, 1, 1)[0].any()


def test_blows_of_the_track_are_at_their_places(tmp_path: Path) -> None:
    text = "[section.blows]\nevery_m = 20.0\nblow_m_s2 = 40.0\n"
    added, distance = blows_of(scenario_with(tmp_path, text), 0, 0)
    begins = np.flatnonzero(np.diff(np.abs(added[0]) > 0.0, prepend=False) & (np.abs(added[0]) > 0.0))
    assert len(begins) > 1
    assert np.mod(distance[begins] + 0.05, 20.0) == pytest.approx(0.05, abs=0.05)


def test_positions_repeat_in_tunnels(tmp_path: Path) -> None:
    frozen = scenario_with(tmp_path, "[position]\nfrozen_every_m = 40.0\nfrozen_length_m = 12.0\n")
    run = vehicle_run(frozen, scenario_track(frozen), frozen.vehicles[0], 0)
    inside = np.mod(run.distance, 40.0) < 12.0
    assert inside.any()
    steps = np.diff(run.reported)
    assert np.all(steps[~inside[1:]] > 0.0)
    first = np.flatnonzero(np.diff(inside.astype(int)) > 0) + 2
    assert np.all(steps[first] == 0.0)


@pytest.mark.parametrize(("serial_given", "campaign", "field"), [("nobody", 1, "wheelset"), ("", 99, "from_campaign")])
def test_a_flat_of_no_wheelset_or_no_campaign_is_refused(
    tmp_path: Path, serial_given: str, campaign: int, field: str
) -> None:
    name = serial_given or serial(scenario_with(tmp_path, ""), 0)
    with pytest.raises(InputError, match=field):
        scenario_with(tmp_path, FLAT.format(serial=name, wheel="left", campaign=campaign))


def test_drawn_fleets_have_flats() -> None:
    path = Path(__file__).parents[3] / "bench" / "vehicle_scenarios" / "flat.toml"
    assert [flat.wheelset for flat in load_scenario(path).wheels.flats] == ["W03"]
