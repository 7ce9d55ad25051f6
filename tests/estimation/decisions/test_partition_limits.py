"""Which windows of a section make an epoch: the limits, and what another window would change."""

from __future__ import annotations

import random
from collections.abc import Sequence

import pytest

from estimation.track.passes import Entry, Group, PartitionParameters, ProfileLife, first_epoch, newest_within
from estimation.track.settings import AlignmentSettings
from estimation.values.units import LATEST_NS
from estimation.values.windows import WindowQuality, WindowRecord, WindowState

SECOND_NS = 10**9
HOUR_NS = 3600 * SECOND_NS
QUALITY = WindowQuality(1.0, 0.0, 0, 0.0, 0.0, 20.0, 20.0, 1.0, sensor_fault=False)


def at(start_ns: int, wheelset: str = "W", vehicle: str = "V") -> Entry:
    record = WindowRecord(
        wheelset, start_ns, 30 * SECOND_NS, vehicle, 1, "S", 0.0, QUALITY, WindowState.PENDING, None, "d", 0
    )
    return record, ProfileLife(wheelset)


def journey(begin_ns: int, windows: int, wheelset: str = "W", vehicle: str = "V") -> list[Entry]:
    return [at(begin_ns + 30 * SECOND_NS * number, wheelset, vehicle) for number in range(windows)]


def first(entries: Sequence[Entry], most_windows: int = 480, most_wheelsets: int = 48) -> Group:
    ordered = sorted(entries, key=lambda one: (one[0].start_ns, one[0].wheelset))
    return first_epoch(ordered, most_windows, most_wheelsets, PartitionParameters())


def test_the_limits_are_these() -> None:
    assert PartitionParameters() == PartitionParameters(pause_h=6.0, least_windows=12, journey_pause_s=300.0)
    assert (AlignmentSettings().most_windows, AlignmentSettings().most_wheelsets) == (480, 48)


@pytest.mark.parametrize(("beyond_ns", "windows"), [(0, 13), (1, 12)])
def test_a_long_pause_ends_an_epoch(beyond_ns: int, windows: int) -> None:
    group = first([*journey(0, 12), at(330 * SECOND_NS + 6 * HOUR_NS + beyond_ns)])
    assert len(group.entries) == windows
    assert (group.horizon_ns == LATEST_NS) == (windows == 13)


@pytest.mark.parametrize(("before", "windows"), [(11, 12), (12, 12)])
def test_a_pause_behind_few_windows_ends_nothing(before: int, windows: int) -> None:
    group = first([*journey(0, before), at(48 * HOUR_NS)])
    assert len(group.entries) == windows
    assert (group.horizon_ns == LATEST_NS) == (before == 11)


@pytest.mark.parametrize(("pause_s", "windows"), [(300, 24), (300.5, 12)])
def test_journeys_stay_whole(pause_s: float, windows: int) -> None:
    """What begins within a journey's pause belongs to it, also behind what would have ended the epoch."""
    second = 330 * SECOND_NS + round(pause_s * SECOND_NS)
    assert len(first([*journey(0, 12), *journey(second, 12)], most_windows=24).entries) == 24
    group = first([*journey(0, 12), *journey(second, 13)], most_windows=24)
    assert len(group.entries) == windows


@pytest.mark.parametrize(("most", "windows"), [(24, 24), (23, 12)])
def test_an_epoch_holds_whole_journeys_up_to_its_windows(most: int, windows: int) -> None:
    assert len(first([*journey(0, 12), *journey(HOUR_NS, 12)], most).entries) == windows


@pytest.mark.parametrize(("wheelsets", "windows"), [(3, 36), (2, 24)])
def test_an_epoch_holds_so_many_wheelsets(wheelsets: int, windows: int) -> None:
    entries = [one for number in range(3) for one in journey(number * HOUR_NS, 12, f"W{number}")]
    assert len(first(entries, most_wheelsets=wheelsets).entries) == windows


def test_another_window_before_the_horizon_alone_changes_an_epoch() -> None:
    entries = [*journey(0, 12), *journey(24 * HOUR_NS, 12)]
    group = first(entries)
    assert group.horizon_ns == 24 * HOUR_NS
    assert first([*entries, at(group.horizon_ns + 1, "X", "U")]) == group
    assert first([*entries, at(2 * HOUR_NS, "X", "U")]) != group


def test_epochs_do_not_depend_on_which_vehicle_is_named_first() -> None:
    entries = [*journey(0, 12), *journey(5 * SECOND_NS, 12, "X", "U"), *journey(24 * HOUR_NS, 3)]
    groups = [first(random.Random(seed).sample(entries, len(entries))) for seed in range(4)]  # noqa: S311 - an order
    assert all(group == groups[0] for group in groups)
    assert len(groups[0].entries) == 24


@pytest.mark.parametrize(("most", "wheelsets", "chosen"), [(4, 9, 4), (9, 1, 1), (9, 2, 6)])
def test_the_newest_windows_are_solved_together(most: int, wheelsets: int, chosen: int) -> None:
    entries = [at(number * SECOND_NS, "W" if number < 5 else "X") for number in range(6)]
    found, rest = newest_within(entries, most, wheelsets)
    assert [one[0].start_ns for one in [*found, *rest]] == [number * SECOND_NS for number in range(5, -1, -1)]
    assert len(found) == chosen
