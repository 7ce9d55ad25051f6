"""What has changed under the epochs of a section, and which windows are to be estimated on another version."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import pytest
import stored_values as make

from bench.put_values import put_table
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.track import EpochMember, FoldState, FoundOfVehicles, TrackEpoch
from estimation.values.units import LATEST_NS
from estimation.values.windows import DueStage, WindowPosition, WindowState
from fleet_db.storage import SqlStorage

OF_THE_ALIGNMENT = (
    ReasonCode.ALIGNMENT_UNKNOWN,
    ReasonCode.NO_USABLE_SAMPLE,
    ReasonCode.INTERRUPTED,
    ReasonCode.TOO_FEW_USABLE,
    ReasonCode.IN_CURVES,
    ReasonCode.OUTSIDE_BINS,
)
NOTHING = ([], [])
FIRST, SECOND, THIRD = (make.START + number * make.LENGTH for number in range(3))


def put_epoch(
    storage: SqlStorage,
    number: int,
    starts: Sequence[int],
    version: int | None,
    same_since: int | None,
    estimated_on: int | None = None,
) -> None:
    epoch = TrackEpoch(
        "S-7", number, "before", "digest", LATEST_NS, len(starts), waits=False, after=FoldState(version, same_since),
        estimated_on=estimated_on or version, report=1, recorded_ns=1,
    )  # fmt: skip
    with storage.write() as unit:
        records = [one for one in unit.windows.list("WS-1") if one.start_ns in starts]
        unit.epochs.put(epoch, [EpochMember(record, "context", "assumed") for record in records])


@pytest.fixture
def epochs(fleet: SqlStorage) -> SqlStorage:
    """Return a store with an epoch of two windows, placed, and one of a third."""
    with fleet.write() as unit:
        for number in range(3):
            window = make.window(number)
            unit.windows.put(window, 10.0, 1)
        for record in unit.windows.list("WS-1")[:2]:
            unit.tracks.put_positions([WindowPosition("WS-1", record.start_ns, record.content_digest, 1)])
    put_epoch(fleet, 1, (FIRST, SECOND), 1, 1)
    put_epoch(fleet, 2, (THIRD,), 2, 1)
    with fleet.write() as unit:
        unit.due.remove_seen(DueStage.ALIGNMENT, unit.due.of_section(DueStage.ALIGNMENT, "S-7"))
    return fleet


def news(storage: SqlStorage, section: str = "S-7") -> tuple[list[int], list[int]]:
    """Return the starts of the windows that are listed, and the epochs that are stale."""
    with storage.read() as unit:
        starts = [one.start_ns for one in unit.epochs.listed(section)]
        return starts, [one.number for one in unit.epochs.list(section) if one.stale]


def test_nothing_is_new_while_nothing_changes(epochs: SqlStorage) -> None:
    assert news(epochs) == news(epochs, "S-8") == NOTHING


def test_a_window_that_comes_is_news_from_its_start(epochs: SqlStorage) -> None:
    with epochs.write() as unit:
        unit.windows.put(make.window(4), 10.0, 2)
        unit.windows.put(make.window(3, track_section=None), 10.0, 2)  # of no section
    assert news(epochs) == ([make.START + 4 * make.LENGTH], [])


@pytest.mark.parametrize(("seed", "mileage_km", "vehicle"), [(1, 10.0, "V-1"), (0, 11.0, "V-1"), (0, 10.0, "V-2")])
def test_a_window_with_other_content_mileage_or_vehicle_is_news(
    epochs: SqlStorage, seed: int, mileage_km: float, vehicle: str
) -> None:
    with epochs.write() as unit:
        unit.windows.put(make.window(1, seed=seed, vehicle=vehicle), mileage_km, 2)
    assert news(epochs) == ([SECOND], [])
    with epochs.read() as unit:
        (listed,) = unit.epochs.listed("S-7")
        assert listed.record is not None
        assert listed.held is not None
        assert (listed.record.mileage_km, listed.held.mileage_km) == (mileage_km, 10.0)
        assert (listed.held.section, listed.held.epoch, listed.held.vehicle) == ("S-7", 1, "V-1")


@pytest.mark.parametrize("change", [{"track_section": "S-8"}, {"track_section": None}])
def test_a_window_that_is_of_another_section_now_is_news_of_the_one_that_had_it(
    epochs: SqlStorage, change: dict[str, str | None]
) -> None:
    with epochs.write() as unit:
        unit.tracks.add_section(replace(make.SECTION, code="S-8", number=8))
        unit.windows.put(make.window(1, **change), 10.0, 2)
    assert news(epochs) == ([], [1])
    assert news(epochs, "S-8")[0] == [SECOND][: change["track_section"] is not None]


def test_epochs_whose_positions_were_forgotten_are_named(epochs: SqlStorage) -> None:
    with epochs.write() as unit:
        unit.windows.look_again([("WS-1", THIRD)])  # had none
    assert news(epochs) == NOTHING
    with epochs.write() as unit:
        unit.windows.look_again([("WS-1", SECOND)])
    assert news(epochs) == ([], [1])


def test_epochs_that_have_lost_a_window_to_another_are_named(epochs: SqlStorage) -> None:
    put_epoch(epochs, 2, (SECOND, THIRD), 2, 1)
    assert news(epochs) == ([], [1])
    put_epoch(epochs, 1, (FIRST,), 1, 1)
    assert news(epochs) == NOTHING


def test_windows_that_an_epoch_lets_go_are_listed(epochs: SqlStorage) -> None:
    put_epoch(epochs, 1, (FIRST,), 1, 1)
    assert news(epochs) == ([SECOND], [])
    with epochs.write() as unit:
        unit.epochs.start_again("S-7")
    assert news(epochs) == ([FIRST, SECOND, THIRD], [])


def estimated(storage: SqlStorage, start_ns: int, version: int | None) -> None:
    with storage.write() as unit:
        (record,) = (one for one in unit.windows.list("WS-1") if one.start_ns == start_ns)
        put_table(unit, "WS-1", start_ns, make.bin_table(), version, record.content_digest)
        unit.windows.mark("WS-1", start_ns, WindowState.ESTIMATED)


def outdated(storage: SqlStorage) -> Sequence[tuple[str, int]]:
    with storage.read() as unit:
        return unit.epochs.outdated(["S-7"])


def test_windows_are_outdated_on_another_version_than_that_of_their_epoch_or_the_chain(epochs: SqlStorage) -> None:
    assert outdated(epochs) == []  # none is estimated
    for start_ns, version in ((FIRST, 1), (SECOND, 2), (THIRD, 1)):
        estimated(epochs, start_ns, version)
    assert outdated(epochs) == [("WS-1", SECOND), ("WS-1", THIRD)]
    put_epoch(epochs, 2, (THIRD,), 2, 2)  # from now on version 1 differs materially
    assert outdated(epochs) == [("WS-1", FIRST), ("WS-1", THIRD)]
    with epochs.read() as unit:
        keys = [("WS-1", at) for at in (FIRST, SECOND, THIRD)]
        assert unit.epochs.alignment_versions([*keys, ("WS-1", 5)]) == dict.fromkeys(keys, 2)


@pytest.mark.parametrize("code", [*OF_THE_ALIGNMENT, ReasonCode.FILE_DAMAGED])
def test_windows_that_another_alignment_may_admit_are_outdated(epochs: SqlStorage, code: ReasonCode) -> None:
    with epochs.write() as unit:
        for start_ns, version in ((FIRST, 1), (SECOND, None)):
            unit.windows.mark("WS-1", start_ns, WindowState.REFUSED, Reason(code, "so"))
            unit.epochs.note_all_refused({("WS-1", start_ns): version})
    assert outdated(epochs) == ([("WS-1", SECOND)] if code in OF_THE_ALIGNMENT else [])


def test_windows_of_a_vehicle_are_outdated_on_a_version_older_than_what_was_found_of_it(epochs: SqlStorage) -> None:
    for start_ns, version in ((FIRST, 1), (SECOND, 1), (THIRD, 2)):
        estimated(epochs, start_ns, version)
    assert outdated(epochs) == []
    with epochs.write() as unit:
        unit.epochs.put_found("S-7", 2, FoundOfVehicles(2, {"V-9": 0.9}))
    assert outdated(epochs) == []  # these are of another vehicle
    with epochs.write() as unit:
        unit.epochs.put_found("S-7", 2, FoundOfVehicles(2, {"V-1": 0.9, "V-2": 1.0}))
    assert outdated(epochs) == [("WS-1", FIRST), ("WS-1", SECOND)]
    with epochs.read() as unit:
        assert unit.epochs.alignment_versions([("WS-1", FIRST)]) == {("WS-1", FIRST): 2}
        assert unit.epochs.found("S-7", 3, 1) == {"V-1": 0.9, "V-2": 1.0}
        assert unit.epochs.found("S-7", 2, 1) == unit.epochs.found("S-7", 3, 2) == {}
    with epochs.write() as unit:
        unit.epochs.put_found("S-7", 2, None)
    assert outdated(epochs) == []
    with epochs.write() as unit:
        unit.epochs.put_found("S-7", 2, FoundOfVehicles(2, {"V-1": 0.9}))
        unit.epochs.start_again("S-7", 1)
        assert unit.epochs.found("S-7", 3, 1) == {}


def test_a_window_is_estimated_on_the_version_that_its_epoch_names(epochs: SqlStorage) -> None:
    put_epoch(epochs, 2, (THIRD,), 2, 1, estimated_on=1)
    for start_ns in (FIRST, SECOND, THIRD):
        estimated(epochs, start_ns, 1)
    assert outdated(epochs) == []
    put_epoch(epochs, 2, (THIRD,), 2, 2, estimated_on=2)
    assert len(outdated(epochs)) == 3
