"""A measured wheel profile on file, complete enough for the contact search."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Literal

import numpy as np

from estimation.contact.profiles import TREAD_DATUM, Profile
from estimation.errors import ProfileError
from ingest.bounded_file import PROFILE_BYTES, read_text_within
from ingest.input_file import InputTable, Text, read_json
from ingest.profiles.files import measured_profile_of

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
    content = {
        "format": FORMAT,
        "name": profile.name,
        "y_m": profile.y.tolist(),
        "z_m": profile.z.tolist(),
        "slope_1": profile.slope.tolist(),
    }
    return json.dumps(content)


FLANGE_END = -0.045  # m from the tread datum: contact in flanging comes 2 mm nearer to the tip at most
TREAD_END = 0.030  # m: contact at 12 mm of gauge widening and 10 mm of displacement stays within
MIN_FLANGE_HEIGHT = 0.015  # m below the tread


def read_wheel_profile(path: Path) -> Profile:
    """Return the wheel profile in a file.

    Args:
        path: A file in a format of ``read_profile``, two columns in mm; or one of an exported registry.
    """
    if path.suffix.lower() == SUFFIX:
        return _whole(read_stored_profile(path), path)
    return wheel_profile_of(read_text_within(path, PROFILE_BYTES, ProfileError, errors="replace"), path)


def wheel_profile_of(text: str, file: Path) -> Profile:
    """Return the wheel profile that the content of a file describes."""
    try:
        return _whole(measured_profile_of(text, file, "wheel").profile, file)
    except ProfileError as error:
        if _is_rail(text, file):
            raise ProfileError("is the profile of a rail; that of a wheel is needed", file=file) from error
        raise


def _is_rail(text: str, file: Path) -> bool:
    try:
        measured_profile_of(text, file, "rail")
    except ProfileError:
        return False
    return True


def _whole(profile: Profile, path: Path) -> Profile:
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
