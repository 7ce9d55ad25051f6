"""The profiles of both wheels of a wheelset packed."""

from __future__ import annotations

from estimation.contact.profiles import Profile
from fleet_db.packing import Unpacked, pack, unpack

KIND = "wheel_pair"
VERSION = 1
ARRAYS = ("y", "z", "slope")


def pack_wheel_pair(left: Profile, right: Profile) -> bytes:
    """Return both profiles as one blob."""
    sides = {"left": left, "right": right}
    return pack(
        KIND,
        VERSION,
        {side: profile.name for side, profile in sides.items()},
        {f"{side}_{name}": getattr(profile, name) for side, profile in sides.items() for name in ARRAYS},
    )


def unpack_wheel_pair(blob: bytes, *, where: str) -> tuple[Profile, Profile]:
    """Return the left and the right profile, bit for bit.

    Raises
    ------
    DamagedError
        The blob is damaged; ``where`` names it.
    """
    packed = unpack(blob, KIND, where=where)
    return _side(packed, "left"), _side(packed, "right")


def _side(packed: Unpacked, side: str) -> Profile:
    return Profile("wheel", packed.scalars[side], *(packed.arrays[f"{side}_{name}"] for name in ARRAYS))
