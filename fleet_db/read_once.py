"""Records that a transaction has read."""

from __future__ import annotations

from collections.abc import Callable, Collection, Hashable, Mapping
from dataclasses import dataclass, field
from typing import Any, TypeVar

Key = TypeVar("Key", bound=Hashable)
Record = TypeVar("Record")


@dataclass(frozen=True, slots=True)
class ReadOnce:
    """Records by kind and key: a transaction that sees one snapshot reads none of them again.

    Attributes:
        snapshot: Whether the transaction sees one snapshot; one that writes reads anew each time.
        together: Wheelsets of which all is read together.
    """

    snapshot: bool = False
    together: set[str] = field(default_factory=set)
    _records: dict[str, dict[Any, Any]] = field(default_factory=dict)

    def of(
        self, kind: str, keys: Collection[Key], read: Callable[[Collection[Key]], Mapping[Key, Record]]
    ) -> dict[Key, Record]:
        """Return records by key; a key without one is left out.

        Args:
            read: Reads those of some keys.
        """
        known = self._of_kind(kind)
        missing = [key for key in dict.fromkeys(keys) if key not in known]
        if missing:
            found = read(missing)
            known.update((key, found.get(key)) for key in missing)
        return {key: known[key] for key in keys if known[key] is not None}

    def renew(self, version: str | None) -> None:
        """Let what others have changed meanwhile be seen; a transaction that writes remembers nothing."""

    def _of_kind(self, kind: str) -> dict[Any, Any]:
        """Return the records of a kind that need not be read; what is read is added to it."""
        return self._records.setdefault(kind, {}) if self.snapshot else {}

    def remember(self, kind: str, records: Mapping[Any, Any]) -> None:
        """Let records be those that this transaction has read."""
        self._records.setdefault(kind, {}).update(records)

    def known(self, kind: str, key: Hashable) -> Any:  # noqa: ANN401 - a record of this kind
        """Return a record that :meth:`of` has read; None where it has not, or there is none."""
        return self._records.get(kind, {}).get(key)

    def is_absent(self, kind: str, key: Hashable) -> bool:
        """Return whether :meth:`of` has looked for a record and found none."""
        records = self._records.get(kind, {})
        return key in records and records[key] is None

    def of_wheelset(
        self, kind: str, wheelset: str, read: Callable[[Collection[str]], Mapping[str, Record]]
    ) -> Record | None:
        """Return what :meth:`of_wheelsets` does of one; None where it has none."""
        return self.of_wheelsets(kind, [wheelset], read).get(wheelset)

    def of_wheelsets(
        self, kind: str, wheelsets: Collection[str], read: Callable[[Collection[str]], Mapping[str, Record]]
    ) -> dict[str, Record]:
        """Return what :meth:`of` does of wheelsets; one of those that are read together is read with all of them."""
        if self.snapshot and not self.together.isdisjoint(wheelsets):
            self.of(kind, sorted(self.together), read)
        return self.of(kind, wheelsets, read)

    def one(self, kind: str, key: Hashable, read: Callable[[], Record]) -> Record:
        """Return a record of which there may be none.

        Args:
            read: Reads it.
        """

        def known(_: Collection[Hashable]) -> Mapping[Hashable, tuple[Record]]:
            return {key: (read(),)}

        return self.of(kind, [key], known)[key][0]
