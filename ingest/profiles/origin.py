"""What y = 0 of a wheel file is."""

from __future__ import annotations

from enum import StrEnum


class Origin(StrEnum):
    """What y = 0 of a wheel file is. A rail needs none: it is placed by its gauge."""

    AUTO = "auto"  # by the distance from the tip of the flange
    DATUM = "datum"  # the tread datum, 70 mm from the flange back
    FLANGE_BACK = "flange-back"
