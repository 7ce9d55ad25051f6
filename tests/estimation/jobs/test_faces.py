"""Over a year of a fleet no two faces of the product differ in a number: all print what is believed now."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import closing
from pathlib import Path

import httpx
import numpy as np
import pytest
from faces import compared
from running_service import running
from test_wear_jobs import feed, run_jobs
from wheelset_life import DAY_NS, START_NS, geometry_record, register, run_windows

from api.factory import open_store
from api.settings import Settings
from bench.put_values import put_geometry
from estimation.storage import Storage
from estimation.values.registry import Reprofiling
from fleet_db.migrate import upgrade

WORN = 0.0011  # conicity per day, of the limit's 0.25 in the year
LIVES = {  # conicity at the begin and per day
    "W1": (0.15, WORN),
    "W2": (0.15, 0.5 * WORN),
    "W3": (0.36, 0.1 * WORN),
    "W4": (0.20, 0.0),
    "W5": (0.15, 3.0 * WORN),
    "W6": (0.25, WORN),
    "W7": (0.38, 0.4 * WORN),
    "W8": (0.10, 0.0),
}
TURNED, TURNED_ON = "W5", 120
STORED, SILENT_FROM = "W8", 150
RUNS_AHEAD = "W6"  # its windows are not estimated any more
AHEAD_FROM = 90
INTERVAL_DAYS = 4


def lived(storage: Storage, first: int, last: int) -> None:
    """Store what some days bring: an interval every fourth day, the current geometry, and windows of the last day."""
    rng = np.random.default_rng(first)
    with storage.write() as unit:
        for serial, (conicity, rate) in LIVES.items():
            turned = serial == TURNED and first > TURNED_ON
            baseline, since = int(turned), TURNED_ON if turned else 0
            end = (
                min(last, AHEAD_FROM) if serial == RUNS_AHEAD else min(last, SILENT_FROM) if serial == STORED else last
            )
            days = [day for day in range(first, end + 1) if day % INTERVAL_DAYS == 0]
            for day in days:
                value = conicity + rate * (day - since) + 0.006 * float(rng.standard_normal())
                put_geometry(unit, geometry_record(serial, day, day, value, baseline=baseline))
            if days:
                value = conicity + rate * (days[-1] - since)
                put_geometry(unit, geometry_record(serial, None, days[-1], value, baseline=baseline, recorded_ns=last))
    for serial in LIVES:
        if serial != STORED or last <= SILENT_FROM:
            run_windows(storage, serial, last, 3, faulty=serial == RUNS_AHEAD and last > AHEAD_FROM)


@pytest.mark.parametrize(
    ("days", "step"), [(100, 50), pytest.param(365, 10, marks=pytest.mark.slow)], ids=["100 days", "a year"]
)
def test_no_two_faces_differ_in_a_number(tmp_path: Path, days: int, step: int) -> None:
    settings = Settings(data_dir=tmp_path, port=0, log_level="warning", _env_file=None)
    upgrade(settings.url)
    differences: list[str] = []
    seen: set[str] = set()
    numbers = 0
    with closing(open_store(settings)) as storage:
        registered(storage, list(LIVES))
        with running(settings) as address, httpx.Client(base_url=address, timeout=60.0) as client:
            for last in range(step, days + 1, step):
                if last - step < TURNED_ON <= last:
                    with storage.write() as unit:
                        unit.registry.add_reprofiling(
                            Reprofiling(TURNED, START_NS + TURNED_ON * DAY_NS, 1e3 * TURNED_ON)
                        )
                lived(storage, last - step + 1, last)
                run_jobs(storage, last + 0.5)
                before = len(feed(storage))
                run_jobs(storage, last + 0.6)
                assert len(feed(storage)) == before, "the same again is no news"
                found = compared(client, tmp_path)
                differences += [f"day {last}: {one}" for one in found.differences]
                seen |= found.seen
                numbers += found.numbers
    assert differences == []
    assert numbers > 100 * days / step
    assert seen >= {"over_limit", "fine"}
    if days > AHEAD_FROM + step:
        wanted = {"over_limit", "probably_over", "due", "fine", "unknown", "conicity_limit", "limit_forecast"}
        assert wanted - seen == set()


def registered(storage: Storage, serials: Sequence[str]) -> None:
    """Put four wheelsets under each vehicle."""
    for number in range(0, len(serials), 4):
        register(storage, *serials[number : number + 4], vehicle=f"V{1 + number // 4}")
