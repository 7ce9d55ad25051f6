"""Representations that are kept as they were sent, for as long as what they represent has not changed.

A key names the version of everything that the representation shows, so that nothing is ever out of date: a change makes
another key, and the old entry is displaced in its turn.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, field
from threading import Lock

CACHED_BYTES = 64 << 20
"""Size of the representations that one process keeps, in bytes."""


@dataclass(slots=True)
class RepresentationCache:
    """The least recently used representation is displaced first; safe for threads.

    Attributes:
        limit_bytes: Size of all representations together.
    """

    limit_bytes: int = CACHED_BYTES
    _held: OrderedDict[Hashable, bytes] = field(default_factory=OrderedDict)
    _bytes: int = 0
    _lock: Lock = field(default_factory=Lock)

    def get_or_make(self, key: Hashable, make: Callable[[], bytes]) -> bytes:
        """Return what is kept under a key, or make it and keep it.

        Args:
            key: With the version of all that the representation shows.
        """
        with self._lock:
            known = self._held.get(key)
            if known is not None:
                self._held.move_to_end(key)
                return known
        made = make()
        with self._lock:
            self._keep(key, made)
        return made

    def get_or_make_all(
        self, keys: Mapping[int, Hashable], make: Callable[[Sequence[int]], Mapping[int, bytes]]
    ) -> Mapping[int, bytes]:
        """Return what is kept of several under one name each, and make and keep what is missing, all at once.

        Args:
            keys: By number; each with the version of all that its representation shows.
        """
        with self._lock:
            found = {number: self._held[key] for number, key in keys.items() if key in self._held}
            for number in found:
                self._held.move_to_end(keys[number])
        missing = [number for number in keys if number not in found]
        if missing:
            made = make(missing)
            with self._lock:
                for number, representation in made.items():
                    self._keep(keys[number], representation)
            found |= made
        return found

    def _keep(self, key: Hashable, made: bytes) -> None:
        if key in self._held or len(made) > self.limit_bytes:
            return
        self._held[key] = made
        self._bytes += len(made)
        while self._bytes > self.limit_bytes:
            _, displaced = self._held.popitem(last=False)
            self._bytes -= len(displaced)
