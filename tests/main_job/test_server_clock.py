"""The server's clock ahead by 400 days, and right again: what is served is what was found last."""

from __future__ import annotations

from one_database import url_on_sqlite
from tiny_fleet import HOUR_NS, WORN, Deployment

from estimation.values.geometry import GeometryRecord
from estimation.values.trend import TrendRecord
from ingest.simulator.fleet import FleetReport

DAY_NS = 24 * HOUR_NS


def served(fleet: Deployment, as_of_ns: int | None = None) -> tuple[TrendRecord | None, GeometryRecord | None]:
    with fleet.storage.read() as unit:
        return unit.trends.latest(WORN, as_of_ns), unit.geometries.current(WORN, as_of_ns)


@url_on_sqlite
def test_a_clock_that_was_ahead_hides_nothing_once_it_is_right(fleet: Deployment, report: FleetReport) -> None:
    wrong_by = 400 * DAY_NS
    fleet.campaign_over(report.recordings[:2])
    fleet.clock.at_ns += wrong_by
    fleet.run_jobs()
    fleet.clock.at_ns -= wrong_by
    ahead = served(fleet)
    fleet.run_jobs()  # no news: what was found while the clock was ahead stays, and is known now
    assert None not in served(fleet, fleet.clock.at_ns)
    for kept, before in zip(served(fleet, fleet.clock.at_ns), ahead, strict=True):
        assert kept is not None
        assert before is not None
        assert kept.input_digest == before.input_digest
        assert kept.recorded_ns <= fleet.clock.at_ns
    between = fleet.clock.at_ns
    fleet.receive(report.recordings[2:])
    fleet.run_jobs()
    for newest, now, earlier, before in zip(
        served(fleet), served(fleet, fleet.clock.at_ns), served(fleet, between), ahead, strict=True
    ):
        assert newest is not None
        assert now is not None
        assert earlier is not None
        assert before is not None
        assert newest.input_digest == now.input_digest != before.input_digest
        assert earlier.input_digest == before.input_digest  # as it was believed then
