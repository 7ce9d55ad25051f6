"""Fleets of a scenario: measured wheels and rails from files, wear by distribution, any number of wheelsets."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scenario_text import SMALL

from bench.wheelset_motion import wheelset_motion
from estimation.contact.profiles import Profile, rail_profile, wheel_profile
from estimation.contact.wear import TreadWear, worn
from estimation.errors import ScenarioError
from ingest.simulator.axle_motion import axle_motions, contact_of, rails_of, together
from ingest.simulator.campaign import scenario_track, vehicle_run
from ingest.simulator.drawn_fleet import impossible_bogies, shares_of_wear, with_seed
from ingest.simulator.fleet import prepare, run_fleet, simulate_campaign
from ingest.simulator.scenario import Scenario, WheelsetPlan
from ingest.simulator.scenario_file import read_scenario

NO_GAUGE = SMALL.replace("gauge_std_mm = 0.5\nsurvey_alignment_std_mm = 0.1\nsurvey_gauge_std_mm = 0.2\n", "")
DRAWN = NO_GAUGE[: NO_GAUGE.index("[[vehicles]]")]
PAIR = '[[drawn_fleet.pairs]]\nname = "P8 on 56E1"\nwheel_profile = "P8"\nrail_profile = "56E1"\n'


def scenario_of(folder: Path, text: str) -> Scenario:
    path = folder / "scenario.toml"
    path.write_text(text, encoding="utf-8")
    return read_scenario(path)


def put(path: Path, profile: Profile) -> Path:
    """Write a profile as two columns of text."""
    np.savetxt(path, 1e3 * np.column_stack([profile.y, profile.z]), fmt="%.6f")
    return path


@pytest.fixture
def wheels(tmp_path: Path) -> Path:
    new = wheel_profile("P8")
    put(tmp_path / "new.txt", new)
    put(tmp_path / "worn.txt", worn(new, TreadWear(1e-3, 3e-3, 44e-3, 1e-3)))
    put(tmp_path / "rail.txt", rail_profile("56E1"))
    return tmp_path


def plans(scenario: Scenario) -> list[WheelsetPlan]:
    return sorted((item for plan in scenario.vehicles for item in plan.wheelsets), key=lambda item: item.serial)


def test_a_wheel_from_a_file_runs_as_the_built_in_one_that_it_is(wheels: Path) -> None:
    on_file = NO_GAUGE.replace('name = "Short section"', 'name = "S"\nrail_file = "rail.txt"')
    both = scenario_of(wheels, on_file.replace('serial = "C"', 'serial = "C"\nwheel_file = "worn.txt"'))
    track = scenario_track(both)
    table = contact_of(both, track, both.vehicles[0].wheelsets[2], 0.0).table
    by_name = NO_GAUGE.replace('serial = "C"', 'serial = "C"\ninitial_wear_mm = 1.0\nflange_wear_share = 1.0')
    built_in = scenario_of(wheels, by_name)
    expected = contact_of(built_in, track, built_in.vehicles[0].wheelsets[2], 0.0).table
    found, named = (
        item.rolling_radius_difference[np.abs(item.lateral_displacement) < 4e-3] for item in (table, expected)
    )
    assert np.median(np.abs(found - named)) < 5e-6


def test_the_wheels_of_a_wheelset_may_differ(wheels: Path) -> None:
    text = NO_GAUGE.replace('serial = "C"', 'serial = "C"\nwheel_left_file = "worn.txt"')
    scenario = scenario_of(wheels, text)
    plan = scenario.vehicles[0].wheelsets[2]
    assert plan.wheel_files == (wheels / "worn.txt", None)
    table = contact_of(scenario, scenario_track(scenario), plan, 0.0).table
    near = np.abs(table.lateral_displacement) < 4e-3
    left, right = table.contact_angle_left[near], table.contact_angle_right[near][::-1]
    assert np.abs(left - right).max() > 0.01


def test_a_rail_from_a_file_may_contain_its_inclination(wheels: Path) -> None:
    text = NO_GAUGE.replace(
        'name = "Short section"', 'name = "S"\nrail_file = "rail.txt"\nrail_file_inclination_1_in = 0'
    )
    scenario, leaning = scenario_of(wheels, text), scenario_of(wheels, text.replace("_in = 0", "_in = 40"))
    assert (scenario.section.file_inclination, leaning.section.file_inclination) == (0.0, 1 / 40)
    assert scenario.section.inclination == 1 / 20
    track, plan = scenario_track(scenario), scenario.vehicles[0].wheelsets[0]
    upright, inclined = (contact_of(item, track, plan, 0.0).table for item in (scenario, leaning))
    assert np.abs(upright.rolling_radius_left - inclined.rolling_radius_left).max() > 1e-4


@pytest.mark.parametrize(("drawn", "expected"), [("false", [0, 1, 0, 1, 0, 1, 0]), ("true", None)])
def test_wheels_of_a_drawn_fleet_are_taken_in_turn_or_drawn(
    wheels: Path, drawn: str, expected: list[int] | None
) -> None:
    files = 'wheel_files = [{left = "new.txt"}, {left = "worn.txt", right = "new.txt"}]'
    scenario = scenario_of(wheels, f"{DRAWN}[drawn_fleet]\nwheelsets = 7\n{PAIR}{files}\nwheels_drawn = {drawn}\n")
    given = [(wheels / "new.txt", wheels / "new.txt"), (wheels / "worn.txt", wheels / "new.txt")]
    chosen = [given.index(item.wheel_files) for item in plans(scenario)]  # type: ignore[arg-type]
    assert len(chosen) == 7
    assert [len(plan.wheelsets) for plan in scenario.vehicles] == [4, 3]
    if expected is not None:
        assert chosen == expected
        return
    others = [[item.wheel_files for item in plans(with_seed(scenario, seed))] for seed in range(6)]
    assert len({tuple(other) for other in others}) > 1
    assert shares_of_wear(plans(scenario)[0]) == (1.0,)
    assert set(scenario.files) == {wheels / "new.txt", wheels / "worn.txt"}


def test_measured_wheels_run_and_their_profiles_are_on_file(wheels: Path, tmp_path: Path) -> None:
    files = 'wheel_files = [{left = "worn.txt", right = "new.txt"}]'
    text = f"{DRAWN}[drawn_fleet]\nwheelsets = 1\nprofiles_measured = 1\n{PAIR}{files}\n"
    scenario = scenario_of(wheels, text.replace("campaigns = 2", "campaigns = 1"))
    report = run_fleet(scenario, tmp_path / "out", workers=1)
    assert report.frames > 1000
    written = np.loadtxt(tmp_path / "out" / "w00_left.txt")
    higher = written[:, 1] - np.loadtxt(wheels / "worn.txt")[:, 1]  # heights count from the tread datum
    assert np.ptp(higher) < 2e-3


@pytest.mark.parametrize(
    ("text", "field", "words"),
    [
        ('serial = "C"\nwheel_file = "none.whl"', "vehicles[0].wheelsets[2].wheel_file", r"none\.whl: cannot be read"),
        (
            'serial = "C"\nwheel_left_file = "rail.txt"',
            "vehicles[0].wheelsets[2].wheel_left_file",
            r"rail\.txt.*profile of a rail",
        ),
        ('serial = "C"\nwheel_file = "empty.txt"', "vehicles[0].wheelsets[2].wheel_file", r"empty\.txt"),
        ('serial = "C"\nwheel_file = "metres.txt"', "vehicles[0].wheelsets[2].wheel_file", r"metres\.txt"),
        (
            'serial = "C"\nwheel_file = "new.txt"\nwheel_left_file = "new.txt"',
            "vehicles[0].wheelsets[2].wheel_file",
            "beside",
        ),
    ],
)
def test_a_wheel_file_that_cannot_be_used_is_refused_by_file_and_key(
    wheels: Path, text: str, field: str, words: str
) -> None:
    (wheels / "empty.txt").write_text("")
    new = wheel_profile("P8")
    np.savetxt(wheels / "metres.txt", np.column_stack([new.y, new.z]), fmt="%.9f")
    with pytest.raises(ScenarioError, match=words) as refused:
        scenario_of(wheels, NO_GAUGE.replace('serial = "C"', text))
    assert (refused.value.file, refused.value.field) == (str(wheels / "scenario.toml"), field)
    assert refused.value.line is not None


BAD = [
    ("wheelsets = 7\nvehicles = 2\n", "deepest_wear_mm = 1", "drawn_fleet.vehicles", "cannot be given"),
    ("wheelsets = 0\n", "deepest_wear_mm = 1", "drawn_fleet.wheelsets", "at least 1"),
    ("wheelsets = 7\n", "", "drawn_fleet.pairs[0].deepest_wear_mm", "missing"),
    ("wheelsets = 7\n", "deepest_wear_mm = 1\nwheels_drawn = true", "drawn_fleet.pairs[0].wheels_drawn", "wheel_files"),
    (
        "wear.distribution = 'weibull'\n",
        "deepest_wear_mm = 1",
        "drawn_fleet.wear.distribution",
        "none of steps, uniform, normal, lognormal",
    ),
    ("wear.distribution = 'normal'\n", "deepest_wear_mm = 1", "drawn_fleet.wear.mean_mm", "missing"),
    ("wear.mean_mm = 0.3\n", "deepest_wear_mm = 1", "drawn_fleet.wear.mean_mm", "unknown key"),
    ("wear.lowest_mm = 0.3\n", "deepest_wear_mm = 1", "drawn_fleet.wear.lowest_mm", "unknown key"),
    (
        "wear = {distribution = 'normal', mean_mm = 2, std_mm = 0.1}\n",
        "deepest_wear_mm = 1",
        "drawn_fleet.wear.mean_mm",
        "not between the limits, 0 and 1 mm",
    ),
    (
        "wear = {distribution = 'uniform', lowest_mm = 0.6, highest_mm = 0.5}\n",
        "deepest_wear_mm = 1",
        "drawn_fleet.wear.lowest_mm",
        "above the deepest",
    ),
    ("wear = {distribution = 'normal', mean_mm = 2, std_mm = -1}\n", "", "drawn_fleet.wear.std_mm", "outside"),
    (
        "",
        "deepest_wear_mm = 1\nrail_file_inclination_1_in = 2",
        "drawn_fleet.pairs[0].rail_file_inclination_1_in",
        "no",
    ),
    ("", 'deepest_wear_mm = 1\nrail_file = "no.prr"', "drawn_fleet.pairs[0].rail_file", r"no\.prr: cannot be read"),
    ("", 'wheel_files = [{left = "no.whl"}]', "drawn_fleet.pairs[0].wheel_files[0].left", r"no\.whl: cannot be read"),
    ("", 'wheel_files = [{right = "no.whl"}]', "drawn_fleet.pairs[0].wheel_files[0].left", "missing"),
]


@pytest.mark.parametrize(("fleet", "pair", "field", "words"), BAD)
def test_a_bad_entry_of_a_drawn_fleet_is_refused(tmp_path: Path, fleet: str, pair: str, field: str, words: str) -> None:
    with pytest.raises(ScenarioError, match=words) as refused:
        scenario_of(tmp_path, f"{DRAWN}[drawn_fleet]\n{fleet}{PAIR}{pair}\n")
    assert refused.value.field == field
    assert refused.value.file == str(tmp_path / "scenario.toml")


@pytest.mark.parametrize(
    ("wear", "mean", "std", "lowest", "highest"),
    [
        ("distribution = 'uniform', lowest_mm = 0.03, highest_mm = 0.5", 0.265, 0.136, 0.03, 0.5),
        ("distribution = 'normal', mean_mm = 0.4, std_mm = 0.1", 0.4, 0.1, 0.0, 1.5),
        ("distribution = 'normal', mean_mm = 0.1, std_mm = 0.2, highest_mm = 0.3", 0.14, 0.084, 0.0, 0.3),
        ("distribution = 'lognormal', mean_mm = 0.4, std_mm = 0.2", 0.4, 0.2, 0.0, 1.5),
        ("distribution = 'lognormal', mean_mm = 0.4, std_mm = 0.0", 0.4, 0.0, 0.4, 0.4),
    ],
)
def test_wear_has_the_distribution_asked_for(
    tmp_path: Path, wear: str, mean: float, std: float, lowest: float, highest: float
) -> None:
    text = f"{DRAWN}[drawn_fleet]\nwheelsets = 400\nwheelsets_each = 8\n{PAIR}deepest_wear_mm = 1.5\n"
    scenario = scenario_of(tmp_path, f"{text}[drawn_fleet.wear]\n" + wear.replace(", ", "\n"))
    depths = 1e3 * np.array([0.5 * (item.initial_left + item.initial_right) for item in plans(scenario)])
    assert len(depths) == 400
    assert depths.mean() == pytest.approx(mean, rel=0.06)
    assert depths.std() == pytest.approx(std, rel=0.15, abs=1e-9)
    assert lowest - 1e-9 <= depths.min() <= depths.max() <= highest + 1e-9
    apart = np.array([item.initial_left / item.initial_right for item in plans(scenario)])
    assert np.std(np.log(apart)) == pytest.approx(0.16, rel=0.15)


@pytest.mark.parametrize(("count", "each"), [(3, [3]), (11, [4, 4, 3]), (40, [4] * 10)])
def test_a_fleet_has_as_many_wheelsets_as_asked_for(tmp_path: Path, count: int, each: list[int]) -> None:
    scenario = scenario_of(tmp_path, f"{DRAWN}[drawn_fleet]\nwheelsets = {count}\n{PAIR}deepest_wear_mm = 1\n")
    assert [len(plan.wheelsets) for plan in scenario.vehicles] == each
    assert [item.serial for item in plans(scenario)] == [f"W{rank:02d}" for rank in range(count)]
    registry = prepare(scenario, tmp_path / "out").read_text()
    assert registry.count('"serial"') == count


def ambiguous(path: Path) -> None:
    """Write an upright rail whose sides differ without showing which one is the gauge side."""
    rail = rail_profile("60E1")
    y, z, down = 1e3 * rail.y, 1e3 * rail.z, np.arange(0.5, 9.0, 0.5)
    y = np.concatenate([y[0] - down[::-1] / 20.0, y, y[-1] + down / 20.0])
    z = np.concatenate([z[0] + down[::-1], z, z[-1] + down])
    y -= 1.5 * np.clip((y - 20.0) / 16.0, 0.0, 1.0)
    np.savetxt(path, np.column_stack([y, z]), fmt="%.6f")


def test_rail_file_mirror_says_which_side_is_the_gauge_side(tmp_path: Path) -> None:
    ambiguous(tmp_path / "rail.txt")

    def with_keys(keys: str) -> str:
        return NO_GAUGE.replace('name = "Short section"', f'name = "S"\n{keys}')

    with pytest.raises(ScenarioError, match="rail_file_mirror = true or false") as refused:
        scenario_of(tmp_path, with_keys('rail_file = "rail.txt"'))
    assert refused.value.field == "section.rail_file"
    kept, turned = (
        scenario_of(tmp_path, with_keys(f'rail_file = "rail.txt"\nrail_file_mirror = {value}')).section
        for value in ("false", "true")
    )
    (left, right, _), (mirrored, _, _) = rails_of(kept), rails_of(turned)
    assert left is right
    np.testing.assert_allclose(mirrored.height(-left.y), left.z, atol=1e-9)
    assert np.nanmax(np.abs(mirrored.height(left.y) - left.z)) > 1e-4
    sides = 'rail_left_file = "rail.txt"\nrail_left_file_mirror = true\nrail_right_file = "rail.txt"\n'
    apart = scenario_of(tmp_path, with_keys(f"{sides}rail_right_file_mirror = false")).section
    assert rails_of(apart)[:2] == (mirrored, left)


def test_rail_file_mirror_goes_with_the_pair_of_a_drawn_fleet(tmp_path: Path) -> None:
    ambiguous(tmp_path / "rail.txt")
    pair = 'deepest_wear_mm = 1\nrail_file = "rail.txt"\nrail_file_mirror = true\n'
    scenario = scenario_of(tmp_path, f"{DRAWN}[drawn_fleet]\n{PAIR}{pair}")
    assert with_seed(scenario, 1).section.rail_mirrors == (True, True)


@pytest.mark.parametrize("key", ["rail_file", "rail_left_file", "rail_right_file"])
def test_a_mirror_without_its_file_is_refused(tmp_path: Path, key: str) -> None:
    with pytest.raises(ScenarioError, match=f"needs '{key}'") as refused:
        scenario_of(tmp_path, NO_GAUGE.replace('name = "Short section"', f'name = "S"\n{key}_mirror = true'))
    assert refused.value.field == f"section.{key}_mirror"


BOGIES = """[dynamics]
arrangement = "bogie"
yaw_stiffness = 2.5e6
lateral_stiffness = 2e6
[dynamics.bogie]
wheelbase = 2.5
frame_mass = 2600.0
frame_yaw_inertia = 1500.0
body_mass = 14000.0
[fleet]"""


def test_a_drawn_fleet_with_bogies_runs_two_wheelsets_in_each(tmp_path: Path) -> None:
    fleet = f"[drawn_fleet]\nvehicles = 1\nwheelsets_each = 4\n{PAIR}deepest_wear_mm = 0.5\n"
    scenario = scenario_of(tmp_path, (DRAWN + fleet).replace("[fleet]", BOGIES))
    assert scenario.parameters.load == pytest.approx((1250.0 + 8300.0) * 9.81)
    assert scenario.vehicles[0].axle_offsets == (0.0, 2.5, 19.0, 21.5)
    track = scenario_track(scenario)
    run = vehicle_run(scenario, track, scenario.vehicles[0], 0)
    assert [together(scenario, scenario.vehicles[0], axle) for axle in (0, 3)] == [(0, 1), (2, 3)]
    contacts = [contact_of(scenario, track, plan, 0.0).table for plan in scenario.vehicles[0].wheelsets[2:]]
    front, rear = axle_motions(scenario, track, run, (2, 3), contacts)
    assert front.frame_yaw is not None
    np.testing.assert_array_equal(front.frame_yaw, rear.frame_yaw)
    np.testing.assert_array_equal(wheelset_motion(scenario, track, run, 3).yaw, rear.yaw)
    assert rear.distance[0] == pytest.approx(run.distance[0] - 21.5)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (("", ""), "3 wheelsets, bogies have two each"),
        (('arrangement = "bogie"\n', ""), "arrangement = 'bogie' is needed beside it"),
        (('"bogie"', '"tram"'), "'tram' is none of single_wheelset, bogie"),
    ],
)
def test_bogies_that_do_not_fit_are_refused(tmp_path: Path, change: tuple[str, str], reason: str) -> None:
    with pytest.raises(ScenarioError, match=reason):
        scenario_of(tmp_path, SMALL.replace("[fleet]", BOGIES.replace(*change)))


def test_the_axles_of_a_bogie_are_its_wheelbase_apart() -> None:
    assert impossible_bogies((0.0, 2.5, 19.0, 21.5), 2.5) is None
    assert impossible_bogies((0.0, 2.5, 19.0, 21.4), 2.5) is not None


def test_a_recording_of_bogies_has_both_wheelsets_where_one_node_has_failed(tmp_path: Path) -> None:
    fault = '[vehicles.wheelsets.fault]\nkind = "no_transmission"\nfrom_campaign = 1\n'
    wheelsets = '[[vehicles.wheelsets]]\nserial = "A"\n' + fault + '[[vehicles.wheelsets]]\nserial = "B"\n'
    head = '[[vehicles]]\ncode = "V"\nclass = "coach"\nmax_speed_km_h = 120.0\n'
    scenario = scenario_of(tmp_path, (DRAWN + head + wheelsets).replace("[fleet]", BOGIES))
    batch, truths = simulate_campaign(scenario, scenario_track(scenario), scenario.vehicles[0], 0)
    assert [truth.axle for truth in truths] == [1, 2]
    assert set(batch.arbitration_id[(batch.arbitration_id & 0x780) == 0x180].tolist()) == {0x182, 0x190}
