"""A wheel profile as an exported registry names it: a file from which the same bits are read."""

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
    """Return the wheel profile of a file."""
    file = read_json(path, ProfileError)
    found = file.parse(StoredProfile)
    for name in ("z_m", "slope_1"):
        if len(getattr(found, name)) != len(found.y_m):
            raise file.error(f"{len(getattr(found, name))} numbers for {len(found.y_m)} of y_m", (name,))
    return Profile("wheel", found.name, np.array(found.y_m), np.array(found.z_m), np.array(found.slope_1))


def stored_profile_text(profile: Profile) -> str:
    """Return the content of the file of a profile."""
    columns = {"y_m": profile.y, "z_m": profile.z, "slope_1": profile.slope}
    named = {key: values.tolist() for key, values in columns.items()}
    return json.dumps({"format": FORMAT, "name": profile.name, **named})
