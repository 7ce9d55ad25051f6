"""The motion of windows that have been tabulated, once more: what a rival, which has no stored sums, works on."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import lru_cache

from estimation.errors import PurgedError
from estimation.jobs.steps.load_window import load_window
from estimation.motion.parameters import WindowParameters
from estimation.motion.window_motion import window_motion
from estimation.storage import UnitOfWork
from estimation.values.motion import Motion
from estimation.values.reasons import Reason
from estimation.values.roll_up import Member
from estimation.values.track import Correction, TrackAlignment, TrackLayout
from estimation.values.windows import WindowPosition, WindowRecord


def replayed(
    unit: UnitOfWork, members: Sequence[Member], parameters: WindowParameters
) -> Iterator[tuple[Member, Motion]]:
    """Yield each window with its motion, as ``estimate_windows`` tabulated it.

    A window is left out whose position or content has changed since, so that it is refused today, and one whose
    samples have been purged.

    Args:
        parameters: Class of the vehicle, filters and gates; the same for all windows.

    Raises:
        DamagedError: The samples of a window are damaged; names the file.
    """

    @lru_cache
    def alignment(section: str, version: int | None) -> TrackAlignment | None:
        return unit.tracks.alignment(section, version)

    @lru_cache
    def layout(section: str) -> TrackLayout | None:
        return unit.tracks.layout(section)

    for member in members:
        record, section = member.window.record, member.window.record.track_section
        position = _position(unit, record)
        mounting = unit.registry.mounting_at(record.vehicle, record.axle, record.start_ns)
        try:
            window = load_window(unit, record, parameters.vehicle_class)
        except PurgedError:
            continue
        if isinstance(window, Reason):
            continue
        moved = window_motion(
            window,
            alignment(section, member.window.track_version) if section is not None else None,
            parameters,
            Correction(position.offset_m, position.scale, position.middle_m) if position is not None else None,
            position.reason if position is not None else None,
            mounted_reversed=mounting is not None and mounting.reversed,
            layout=layout(section) if section is not None else None,
        )
        if not isinstance(moved, Reason):
            yield member, moved


def _position(unit: UnitOfWork, record: WindowRecord) -> WindowPosition | None:
    """Return where the window was, unless that was found from other content."""
    position = unit.tracks.position(record.wheelset, record.start_ns)
    return position if position is not None and position.content_digest == record.content_digest else None
