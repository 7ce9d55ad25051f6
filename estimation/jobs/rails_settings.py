"""Settings of the job that parts wheels and rails."""

from __future__ import annotations

from dataclasses import dataclass, field

from estimation.rails.parameters import RailsParameters


@dataclass(frozen=True, slots=True, order=True)
class KnownSection:
    """A section whose rails are as on file: new, ground to their profile, or measured, on a day."""

    code: str
    on_ns: int  # begin of the day, ns UTC


@dataclass(frozen=True, slots=True)
class RailsSettings:
    """Settings of ``refresh_rails``.

    Attributes:
        known_sections: Sections whose rails are as on file, each with the day for which that is known; all others are
            compared with them. A section may have several days.
        model: Parameters of the mixed model.
    """

    known_sections: frozenset[KnownSection] = frozenset()
    model: RailsParameters = field(default_factory=RailsParameters)

    @property
    def period_days(self) -> float:
        """Length of a period, in which rails hardly wear."""
        return self.model.period_days
