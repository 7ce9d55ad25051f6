"""Storage in transactions and the time, as the jobs get them.

`fleet_db` has the storage and `api/pipeline.py` hands it over: the names are here for types only, at run time nothing
of `fleet_db` is imported.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Protocol

if TYPE_CHECKING:
    from fleet_db.storage import SqlStorage as Storage
    from fleet_db.storage import SqlUnitOfWork as UnitOfWork
else:
    Storage = UnitOfWork = Any

__all__ = ["Clock", "Storage", "UnitOfWork"]


class Clock(Protocol):
    """What time it is, ours."""

    def now_ns(self) -> int:
        """Return the time, ns since 1970."""
