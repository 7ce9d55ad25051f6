"""Windows of a wheelset that stay as they are, for their samples or bin tables have been purged, by roll-up."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from estimation.jobs.steps.membership import Membership
from estimation.storage import UnitOfWork
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.roll_up import RollUp
from estimation.values.windows import PassedOver

CONTRADICTED = Reason(
    ReasonCode.SAMPLES_PURGED, "class, mounting, mileage or reprofilings have changed since the samples were purged"
)


@dataclass(slots=True)
class PassedOverWindows:
    """Looks at the windows of one wheelset, as one transaction sees them.

    Attributes:
        unit: Windows are read.
        rules: By which they were rolled.
    """

    unit: UnitOfWork
    rules: Membership
    _windows: Sequence[tuple[int, PassedOver]] | None = field(default=None, init=False)

    def counts(self, roll_ups: Sequence[RollUp]) -> Mapping[str, int]:
        """Return how many windows of the time of some roll-ups stay as they are, by what would have changed them."""
        if self._windows is None:
            self._windows = self.unit.windows.passed_over(self.rules.wheelset)
        if not self._windows:
            return {}
        spans = [(one.first_ns, one.last_ns) for one in roll_ups]
        found = Counter(
            what.value for start_ns, what in self._windows if any(first <= start_ns <= last for first, last in spans)
        )
        return dict(sorted(found.items()))

    def contradicted(self, roll_up: RollUp) -> bool:
        """Whether what is stored of a roll-up is wrong by now: its windows were of another class, place or mileage."""
        counts = self.counts([roll_up])
        other_class = PassedOver.CLASS_CHANGED in counts and self.rules.assumed(roll_up) is None
        return other_class or PassedOver.RECORD_CHANGED in counts or not self.rules.of_its_baseline(roll_up)
