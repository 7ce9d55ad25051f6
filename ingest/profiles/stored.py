"""A wheel profile as an exported registry names it: a file from which the same bits are read.

It stands apart from what smooths points: a command that checks or writes a registry does not wait for that.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Literal

import numpy as np

from estimation.contact.profiles import Profile
from estimation.errors import ProfileError
from ingest.input_file import InputTable, Text, read_json

SUFFIX = ".json"
"""Of the wheel profiles of an exported registry."""


class StoredProfile(InputTable):
    """A wheel profile of an exported registry; metres, z down, y to the field side from the tread datum."""

    format: Literal["treadwatch-profile-1"]
    name: Text
    y_m: list[float]
    z_m: list[float]
    slope_1: list[float]


def read_stored_profile(path: Path) -> Profile:
    """Return the wheel profile of a file."""
    file = read_json(path, ProfileError)
    stored = file.parse(StoredProfile)
    for name, column in (("z_m", stored.z_m), ("slope_1", stored.slope_1)):
        if len(column) != len(stored.y_m):
            raise file.error(f"{len(column)} numbers for {len(stored.y_m)} of y_m", (name,))
    return Profile("wheel", stored.name, np.array(stored.y_m), np.array(stored.z_m), np.array(stored.slope_1))


def stored_profile_text(profile: Profile) -> str:
    """Return the content of the file of a profile."""
    columns = {"y_m": profile.y.tolist(), "z_m": profile.z.tolist(), "slope_1": profile.slope.tolist()}
    return json.dumps({"format": "treadwatch-profile-1", "name": profile.name, **columns})
