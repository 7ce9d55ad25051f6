"""What of the feed a client follows: its filter, to which its cursors are bound."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated

from fastapi import Depends, Query

from api.parameters import CODE
from api.schemas.alerts import KnownKind
from api.services import ServicesDep
from estimation.values.alerts import Severity

MOST_VALUES = 50
FleetCode = Annotated[str, Query(pattern=CODE)]


@dataclass(frozen=True, slots=True)
class FeedFilter:
    """Which events are listed; an empty set is no filter.

    Args:
        severities: An alert is followed to its end once it has had one of them.
        visible: Codes of the fleets that the client may see; None for all.
    """

    fleets: frozenset[str] = frozenset()
    kinds: frozenset[str] = frozenset()
    severities: frozenset[str] = frozenset()
    visible: frozenset[str] | None = None

    @property
    def bound(self) -> Mapping[str, object]:
        """What a cursor is bound to; nothing for the whole feed."""
        named = {"fleet": self.fleets, "kind": self.kinds, "severity": self.severities}
        found: dict[str, object] = {name: sorted(values) for name, values in named.items() if values}
        return found if self.visible is None else found | {"visible": sorted(self.visible)}


async def feed_filter(
    services: ServicesDep,
    fleet: Annotated[
        list[FleetCode] | None, Query(max_length=MOST_VALUES, description="Only of these fleets; may be repeated.")
    ] = None,
    kind: Annotated[
        list[KnownKind] | None, Query(max_length=MOST_VALUES, description="Only of these kinds; may be repeated.")
    ] = None,
    severity: Annotated[
        list[Severity] | None,
        Query(
            max_length=MOST_VALUES,
            description="Only alerts that have had one of these, from then on to their end; may be repeated.",
        ),
    ] = None,
) -> FeedFilter:
    """Return the filter of a request."""
    return FeedFilter(_set(fleet), _set(kind), _set(severity), services.storage.visible_fleets)


def _set(values: Sequence[str] | None) -> frozenset[str]:
    return frozenset(str(value) for value in values or ())


FeedFilterDep = Annotated[FeedFilter, Depends(feed_filter)]
