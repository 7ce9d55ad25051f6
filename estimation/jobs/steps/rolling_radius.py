"""The nominal radius on file against the motion of a wheelset's windows."""

from __future__ import annotations

from collections.abc import Sequence

from estimation.errors import DamagedError, NotFoundError
from estimation.geometry.rolling_radius import check_radius
from estimation.motion.parameters import WindowParameters
from estimation.motion.rolling_sums import RollingSums, rolling_sums
from estimation.storage import UnitOfWork
from estimation.values.reasons import Reason
from estimation.values.windows import WindowRecord

MOST_WINDOWS = 16  # that are looked at; more would not change the std


def radius_contradicted(
    unit: UnitOfWork, windows: Sequence[WindowRecord], parameters: WindowParameters
) -> Reason | None:
    """Return that the windows of a wheelset contradict its radius on file; None where they do not or are silent.

    A window whose samples are missing or damaged takes no part.

    Parameters
    ----------
    unit
        Windows are read.
    windows
        Of one wheelset on vehicles of one class, oldest first.
    parameters
        That class, with the radius on file.
    """
    vehicle_class, parts = parameters.vehicle_class, list[RollingSums]()
    for record in _spread([one for one in windows if not one.quality.hunting.sustained]):
        try:
            window = unit.windows.load(record.wheelset, record.start_ns)
        except (NotFoundError, DamagedError):
            continue  # its table remains
        parts += rolling_sums(window, vehicle_class, parameters.signals)
    return check_radius(parts, vehicle_class.parameters.nominal_radius)


def _spread(windows: Sequence[WindowRecord]) -> list[WindowRecord]:
    """Return at most ``MOST_WINDOWS`` of the windows, evenly spread, the newest one included."""
    count = len(windows)
    few = min(count, MOST_WINDOWS)
    return [windows[count - 1 - step * count // few] for step in reversed(range(few))]
