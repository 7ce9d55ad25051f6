"""The demo raises nothing that comes from the dates of its scenario: it ended yesterday, and silence counts days."""

from __future__ import annotations

import pytest
from windows_finding import silence_finding

from api.terminal.demo import DAY_NS, ending_now
from estimation.alerts.rules.sensor_data import NoDataRule
from ingest.simulator.scenario_file import load_scenario

NOW_NS = 1_800_000_000_000_000_000


@pytest.mark.parametrize("name", ["demo", "demo_single"])
@pytest.mark.parametrize("after_ns", [0, DAY_NS - 1, 12_345 * DAY_NS + 1])
def test_no_vehicle_of_the_demo_is_silent_for_days_after_it(name: str, after_ns: int) -> None:
    now_ns = NOW_NS + after_ns
    plan = ending_now(load_scenario(name), now_ns)
    for vehicle in plan.vehicles:
        last = plan.start_ns(vehicle, plan.sessions.campaigns - 1)
        assert last < now_ns - round(plan.sessions.duration * 1e9)  # nothing is of the future
        later_ns = now_ns + 4 * DAY_NS  # the server is left running
        assert not silence_finding(NoDataRule(), last, plan.sessions.start_ns, later_ns).breached
    unmoved = load_scenario(name)
    last = max(unmoved.start_ns(vehicle, unmoved.sessions.campaigns - 1) for vehicle in unmoved.vehicles)
    assert silence_finding(NoDataRule(), last, unmoved.sessions.start_ns, now_ns).breached
