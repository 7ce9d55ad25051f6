"""``treadwatch settings``: what a deployment may set, and what holds where it does not."""

from __future__ import annotations


def settings() -> None:
    """List the environment variables of a deployment with their defaults; no value that is set is shown."""
    from api.terminal.settings import print_settings

    print_settings()
