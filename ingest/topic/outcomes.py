"""What may become of a message of the topic."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class Outcome(StrEnum):
    """What became of a message, once its offset is committed."""

    STORED = "stored"  # the receipt is new: the bytes were in the raw store already
    KNOWN = "known"  # there was a receipt
    MISSING = "missing"  # no such bytes in the raw store: in quarantine, tried again
    DAMAGED = "damaged"  # other bytes under that digest, or of another size: in quarantine, tried again
    FAILED = "failed"  # the program failed at it: in quarantine, tried again
    OTHER_VEHICLE = "other_vehicle"  # the same chunk was received from another vehicle
    DELETED = "deleted"  # the chunk was deleted by hand
    MALFORMED = "malformed"
    OTHER_VERSION = "other_version"
    CONTRADICTORY = "contradictory"  # key and body name different vehicles


@dataclass(frozen=True, slots=True)
class Refused:
    """A message of which nothing is taken: what it counts as, and why in a sentence."""

    outcome: Outcome
    text: str
