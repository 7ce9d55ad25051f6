"""A profile exactly as it is stored, as an exported registry has it: JSON with heights and slopes, nothing smoothed."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Literal

import numpy as np

from estimation.contact.profiles import Profile
from estimation.errors import ProfileError
from ingest.input_file import InputTable, Text, read_json

FORMAT = "treadwatch-profile-1"
SUFFIX = ".json"


class StoredProfile(InputTable):
    """The whole file; metres, z down, y to the field side from the tread datum."""

    format: Literal["treadwatch-profile-1"]
    name: Text
    y_m: list[float]
    z_m: list[float]
    slope_1: list[float]


def read_stored_profile(path: Path) -> Profile:
    """Return the wheel profile of a file.

    Args:
        path: Written by :func:`stored_profile_text`.

    Raises:
        ProfileError: The file is none, or its numbers are no profile.
    """
    file = read_json(path, ProfileError)
    found = file.parse(StoredProfile)
    for name in ("z_m", "slope_1"):
        if len(getattr(found, name)) != len(found.y_m):
            raise file.error(f"{len(getattr(found, name))} numbers for {len(found.y_m)} of y_m", (name,))
    return Profile("wheel", found.name, np.array(found.y_m), np.array(found.z_m), np.array(found.slope_1))


def stored_profile_text(profile: Profile) -> str:
    """Return the content of the file of a profile."""
    content = {
        "format": FORMAT,
        "name": profile.name,
        "y_m": profile.y.tolist(),
        "z_m": profile.z.tolist(),
        "slope_1": profile.slope.tolist(),
    }
    return json.dumps(content)
