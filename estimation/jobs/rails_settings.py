"""Settings of the job that parts wheels and rails."""

from __future__ import annotations

from dataclasses import dataclass, field

from estimation.rails.parameters import RailsParameters


@dataclass(frozen=True, slots=True)
class RailsSettings:
    """Settings of ``refresh_rails``.

    Attributes
    ----------
    known_sections
        Codes of the sections whose rails are as on file: new, or ground to their profile. All others are compared
        with them.
    model
        Parameters of the mixed model.
    """

    known_sections: frozenset[str] = frozenset()
    model: RailsParameters = field(default_factory=RailsParameters)

    @property
    def period_days(self) -> float:
        """Length of a period, in which rails hardly wear."""
        return self.model.period_days
