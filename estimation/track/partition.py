"""The windows of a section in epochs, in vehicle time: a function of the set of windows, not of when they came.

An epoch is filled with whole journeys of vehicles in the order of their begin. It ends before a journey that comes
after a long pause, if it holds enough windows, and before one with which it would hold too many.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from estimation.track.passes import NANOSECONDS, ProfileLife
from estimation.values.track import OPEN_NS
from estimation.values.windows import WindowRecord

Entry = tuple[WindowRecord, ProfileLife]


@dataclass(frozen=True, slots=True)
class PartitionParameters:
    """When an epoch ends."""

    pause_h: float = 6.0  # hours without a window after which another epoch begins
    least_windows: int = 12  # of an epoch that a pause ends: one short journey alone fixes nothing
    journey_pause_s: float = 300.0  # a longer pause between windows of a vehicle begins a new journey


@dataclass(frozen=True, slots=True)
class Group:
    """Windows of an epoch by start and wheelset, and up to when another window would change which they are."""

    entries: Sequence[Entry]
    horizon_ns: int  # vehicle time; OPEN_NS while the epoch is the last


@dataclass(slots=True)
class _Journey:
    entries: list[Entry]
    vehicle: str
    lives: set[ProfileLife]

    @property
    def first_ns(self) -> int:
        return self.entries[0][0].start_ns

    @property
    def last_ns(self) -> int:
        return self.entries[-1][0].start_ns


def first_epoch(
    entries: Sequence[Entry], most_windows: int, most_wheelsets: int, parameters: PartitionParameters | None = None
) -> Group:
    """Return the windows of the first epoch.

    Args:
        entries: Windows that no earlier epoch holds, by start and wheelset; at least one.
        most_windows, most_wheelsets: Of an epoch; one journey may be more, by the windows of a vehicle at one time.
    """
    p = parameters or PartitionParameters()
    pause_ns, journey_ns = round(p.pause_h * 3600 * NANOSECONDS), round(p.journey_pause_s * NANOSECONDS)
    chosen: list[_Journey] = []
    count, end_ns, horizon_ns = 0, 0, OPEN_NS
    lives: set[ProfileLife] = set()
    for journey in _journeys(entries, journey_ns, most_windows):
        paused = count >= p.least_windows and journey.first_ns - end_ns > pause_ns
        full = count + len(journey.entries) > most_windows or len(lives | journey.lives) > most_wheelsets
        if chosen and (paused or full):
            horizon_ns = max(
                journey.last_ns if full else journey.first_ns, *(one.last_ns + journey_ns for one in chosen)
            )
            break
        chosen.append(journey)
        count += len(journey.entries)
        lives |= journey.lives
        end_ns = max(end_ns, journey.last_ns)
    found = sorted((entry for journey in chosen for entry in journey.entries), key=_place)
    return Group(found, horizon_ns)


def _journeys(entries: Sequence[Entry], pause_ns: int, most: int) -> list[_Journey]:
    """Return the windows by vehicle and run, in order of their begin; a run of more than ``most`` windows is cut."""
    found: list[_Journey] = []
    last: dict[str, _Journey] = {}
    for record, life in entries:
        journey = last.get(record.vehicle)
        together = journey is not None and record.start_ns - journey.last_ns <= pause_ns
        if journey is None or not together or (len(journey.entries) >= most and record.start_ns > journey.last_ns):
            journey = _Journey([], record.vehicle, set())
            last[record.vehicle] = journey
            found.append(journey)
        journey.entries.append((record, life))
        journey.lives.add(life)
    return found


def _place(entry: Entry) -> tuple[int, str]:
    return entry[0].start_ns, entry[0].wheelset


def newest_within(entries: Sequence[Entry], most_windows: int, most_wheelsets: int) -> tuple[list[Entry], list[Entry]]:
    """Return the newest windows that one solution holds, newest first, and the rest in the same order."""
    ordered = sorted(entries, key=lambda entry: (-entry[0].start_ns, entry[0].wheelset))
    chosen: list[Entry] = []
    lives: set[ProfileLife] = set()
    for entry in ordered[:most_windows]:
        if entry[1] not in lives and len(lives) == most_wheelsets:
            break
        lives.add(entry[1])
        chosen.append(entry)
    return chosen, ordered[len(chosen) :]
