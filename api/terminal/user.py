"""Who uses the command line."""

from __future__ import annotations

import getpass


def user_here() -> str:
    """Return who is recorded with what the command line does."""
    try:
        return f"{getpass.getuser()} at the command line"
    except (KeyError, OSError):  # a container may run a user that has no name
        return "the command line"
