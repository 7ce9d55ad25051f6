"""The methods of contact geometry, named without the libraries that they need."""

from __future__ import annotations

from enum import StrEnum


class ContactMethod(StrEnum):
    """How the contact points are found."""

    EN15302 = "en15302"  # no roll, smallest vertical gap on each side separately
    RIGID = "rigid"  # the wheelset rolls until both wheels touch
