"""Contact geometries that were computed before: the same wheels on the same rails always give the same."""

from __future__ import annotations

import hashlib
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass, field
from threading import Lock

from estimation.accuracy.wheel_contact import RailShare, WheelContact, WheelPair, wheel_contact
from estimation.values.reasons import Reason

MOST_KEPT = 2048
"""Each takes some 8 kB."""


@dataclass(frozen=True, slots=True)
class ContactCache:
    """The contact geometries that were asked for last, in one process; safe in threads."""

    _kept: OrderedDict[str, WheelContact | Reason] = field(default_factory=OrderedDict)
    _lock: Lock = field(default_factory=Lock)

    def contact(self, wheels: WheelPair, rails: Sequence[RailShare]) -> WheelContact | Reason:
        """Return the contact geometry of two wheels on rails, or why there is none.

        Args:
            wheels: Profiles, radius and their standard deviation.
            rails: Rails with the share of the running on each.
        """
        key = _digest(wheels, rails)
        with self._lock:
            if key in self._kept:
                self._kept.move_to_end(key)
                return self._kept[key]
        found = wheel_contact(wheels, rails)
        with self._lock:
            self._kept[key] = found
            while len(self._kept) > MOST_KEPT:
                self._kept.popitem(last=False)
        return found


def _digest(wheels: WheelPair, rails: Sequence[RailShare]) -> str:
    digest = hashlib.blake2b(repr((wheels.nominal_radius, wheels.std, tuple(rails))).encode(), digest_size=16)
    for wheel in (wheels.left, wheels.right):
        for values in (wheel.y, wheel.z, wheel.slope):
            digest.update(values.tobytes())
        digest.update(b"/")
    return digest.hexdigest()
