"""The nominal radius on file against the motion of a wheelset's windows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
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
        found = self._sums({start_ns: digest for digest, start_ns in chosen}, assumed)
        if not found and stored is not None and stored.code is ReasonCode.ROLLING_RADIUS_DIFFERS:
            return stored
        parts = [part for start_ns in sorted(found) for part in found[start_ns]]
        return check_radius(parts, assumed.windows.vehicle_class.parameters.nominal_radius)

    def _sums(self, chosen: Mapping[int, str], assumed: Assumed) -> dict[int, tuple[RollingSums, ...]]:
        """Return by start what the windows say that have samples, or had them when they were looked at."""
        found = dict(self.unit.roll_ups.rolling(self.wheelset, chosen, assumed.digest))
        for start_ns in chosen.keys() - found.keys():
            key = (start_ns, assumed.digest)
            if key not in self.fresh:
                parts = self._of_samples(start_ns, assumed)
                if parts is None:
                    continue
                self.fresh[key] = FreshSums(start_ns, chosen[start_ns], assumed.digest, parts)
            found[start_ns] = self.fresh[key].parts
        return found

    def _of_samples(self, start_ns: int, assumed: Assumed) -> tuple[RollingSums, ...] | None:
        try:
            window = self.unit.windows.load(self.wheelset, start_ns)
        except (NotFoundError, DamagedError):
            return None  # its table remains
        return rolling_sums(window, assumed.windows.vehicle_class, assumed.windows.signals)
