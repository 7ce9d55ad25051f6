"""A measured wheel profile on file, complete enough for the contact search."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from estimation.contact.profiles import TREAD_DATUM, Profile
from estimation.errors import ProfileError
from ingest.profiles.files import read_profile

FLANGE_END = -0.045  # m from the tread datum: contact in flanging comes 2 mm nearer to the tip at most
TREAD_END = 0.030  # m: contact at 12 mm of gauge widening and 10 mm of displacement stays within
MIN_FLANGE_HEIGHT = 0.015  # m below the tread


def read_wheel_profile(path: Path) -> Profile:
    """Return the wheel profile in a file.

    Parameters
    ----------
    path
        A file in a format of ``read_profile``; two columns are in mm.

    Raises
    ------
    ProfileError
        The file cannot be read as a wheel profile, or does not hold the whole of flange and tread.
    """
    profile = read_profile(path, "wheel")
    first, last = float(profile.y[0]), float(profile.y[-1])
    if first > FLANGE_END or last < TREAD_END:
        raise ProfileError(
            f"reaches from {first * 1e3:+.1f} to {last * 1e3:+.1f} mm from the tread datum; flange and tread from "
            f"{FLANGE_END * 1e3:+.0f} to {TREAD_END * 1e3:+.0f} mm are needed",
            file=path,
            field="y",
        )
    tip = int(np.argmax(profile.z))
    if not -TREAD_DATUM <= profile.y[tip] <= FLANGE_END or profile.z[tip] < MIN_FLANGE_HEIGHT:
        raise ProfileError(
            f"no flange: its tip is expected between {-TREAD_DATUM * 1e3:+.0f} and {FLANGE_END * 1e3:+.0f} mm from the "
            f"tread datum, {MIN_FLANGE_HEIGHT * 1e3:.0f} mm high or more",
            file=path,
            field="z",
        )
    return profile
