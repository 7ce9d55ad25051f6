"""The nominal radius on file against the motion of a wheelset's windows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from estimation.errors import DamagedError, NotFoundError
from estimation.geometry.rolling_radius import check_radius
from estimation.jobs.steps.vehicle_classes import Assumed
from estimation.motion.rolling_sums import rolling_sums
from estimation.storage import UnitOfWork
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.rolling_sums import RollingSums


@dataclass(frozen=True, slots=True)
class FreshSums:
    """What a window says of its rolling radius, computed just now: to be kept, for the next geometry asks again."""

    start_ns: int
    window_digest: str
    assumed: str
    parts: tuple[RollingSums, ...]


@dataclass(frozen=True, slots=True)
class RadiusOnFile:
    """Looks at the windows of one wheelset that stand for many; each is read once in its life.

    Attributes
    ----------
    unit
        Windows are read.
    wheelset
        Serial number.
    fresh
        What was computed on the way.
    """

    unit: UnitOfWork
    wheelset: str
    fresh: dict[tuple[int, str], FreshSums] = field(default_factory=dict)

    def contradicted(
        self, chosen: Sequence[tuple[str, int]], assumed: Assumed, stored: Reason | None = None
    ) -> Reason | None:
        """Return that windows contradict the radius on file; None where they do not or are silent.

        A window whose samples are missing or damaged takes no part. Where none has samples any more, what was found
        when they were there remains.

        Parameters
        ----------
        chosen
            Content digest and start of the windows.
        assumed
            Their class, with the radius on file.
        stored
            Reason of the geometry that is stored.
        """
        parts: list[RollingSums] = []
        looked_at = False
        for digest, start_ns in chosen:
            found = self._sums(digest, start_ns, assumed)
            looked_at |= found is not None
            parts += found or ()
        if not looked_at and stored is not None and stored.code is ReasonCode.ROLLING_RADIUS_DIFFERS:
            return stored
        return check_radius(parts, assumed.windows.vehicle_class.parameters.nominal_radius)

    def _sums(self, digest: str, start_ns: int, assumed: Assumed) -> tuple[RollingSums, ...] | None:
        key = (start_ns, assumed.digest)
        if key in self.fresh:
            return self.fresh[key].parts
        kept = self.unit.roll_ups.rolling(self.wheelset, start_ns, digest, assumed.digest)
        if kept is not None:
            return kept
        try:
            window = self.unit.windows.load(self.wheelset, start_ns)
        except (NotFoundError, DamagedError):
            return None  # its table remains
        parameters = assumed.windows
        parts = rolling_sums(window, parameters.vehicle_class, parameters.signals)
        self.fresh[key] = FreshSums(start_ns, digest, assumed.digest, parts)
        return parts
