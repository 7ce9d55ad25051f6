"""A damper that has lost damping: in its running gear, from its campaign on, and nowhere else."""

from __future__ import annotations

from pathlib import Path

import pytest
from scenario_text import SMALL

from estimation.errors import InputError
from ingest.simulator.axle_motion import true_suspension
from ingest.simulator.scenario import Scenario
from ingest.simulator.scenario_file import load_scenario, read_scenario

WEAK = """[vehicles.weak_damper]
share = 0.3
from_campaign = 2
running_gear = 2
"""
DEMO = Path(__file__).parents[3] / "ingest" / "simulator" / "scenarios" / "demo.toml"


def with_damper(folder: Path, text: str, table: str) -> Scenario:
    """Return the scenario with the table behind its first vehicle's own keys."""
    at = text.index("[[vehicles.wheelsets]]")
    path = folder / "scenario.toml"
    path.write_text(text[:at] + table + "\n" + text[at:], encoding="utf-8")
    return read_scenario(path)


def test_a_single_wheelset_loses_the_damping_above_it(tmp_path: Path) -> None:
    scenario = with_damper(tmp_path, SMALL, WEAK.replace("running_gear = 2\n", ""))
    vehicle = scenario.vehicles[0]
    before, after = (true_suspension(scenario, vehicle, 0, campaign)[0] for campaign in (0, 1))
    assert before == scenario.parameters
    assert after.lateral_damping == pytest.approx(0.3 * before.lateral_damping)
    assert after.lateral_stiffness == before.lateral_stiffness


def test_a_bogie_loses_its_secondary_damping(tmp_path: Path) -> None:
    text = DEMO.read_text(encoding="utf-8")
    at = text.index("[[vehicles.wheelsets]]")
    path = tmp_path / "demo.toml"
    path.write_text(text[:at] + WEAK + "\n" + text[at:], encoding="utf-8")
    for folder in DEMO.parent.iterdir():
        if folder.is_dir():
            (tmp_path / folder.name).symlink_to(folder)
    scenario = load_scenario(path)
    assert scenario.bogie is not None
    nominal = scenario.bogie.secondary_lateral_damping
    vehicle = scenario.vehicles[0]

    def damping(axle: int, campaign: int) -> float:
        bogie = true_suspension(scenario, vehicle, axle, campaign)[1]
        assert bogie is not None
        return bogie.secondary_lateral_damping / nominal

    shares = {(axle, campaign): damping(axle, campaign) for axle in (0, 1, 2, 3) for campaign in (0, 1, 2)}
    healthy = damping(0, 0)
    weak = {key for key, share in shares.items() if share == pytest.approx(0.3 * healthy)}
    assert weak == {(2, 1), (3, 1), (2, 2), (3, 2)}


@pytest.mark.parametrize(
    "line", ["share = 2.1", "share = -0.1", "share = 0.3\nfrom_campaign = 0", "share = 0.3\nrunning_gear = 0"]
)
def test_impossible_dampers_are_refused(tmp_path: Path, line: str) -> None:
    with pytest.raises(InputError):
        with_damper(tmp_path, SMALL, f"[vehicles.weak_damper]\n{line}\n")
