"""What a job has looked at, so that it looks again only where that is another by now."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Look:
    """A look at a wheelset that found nothing to do."""

    inputs: str  # digest of all that it was made from, 64 hexadecimal digits
    until_ns: int | None = None  # our time from which the same inputs may say something else
    number: int | None = None  # of the newest result that was looked at

    def holds(self, inputs: str, now_ns: int) -> bool:
        """Whether a look at these inputs would find nothing to do either."""
        return self.inputs == inputs and (self.until_ns is None or now_ns < self.until_ns)


@dataclass(frozen=True, slots=True)
class SectionLook:
    """What a look at a track section is made from: the same again would find the same."""

    inputs: str  # digest of settings, classes and what is on file of the section, 64 hexadecimal digits
    touched: int  # how often something had happened to its windows, positions or epochs
