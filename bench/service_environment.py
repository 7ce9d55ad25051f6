"""The environment of a service of the bench: the settings of its deployment, as variables."""

from __future__ import annotations

import os
import sys

from api.settings import PREFIX, Settings


def environment_of(settings: Settings) -> dict[str, str]:
    """Return the environment of a process that has these settings.

    Args:
        settings: Of the deployment; those that are not the default are handed over.
    """
    chosen = {
        f"{PREFIX}{name.upper()}": str(value) for name, value in settings.model_dump(exclude_defaults=True).items()
    }
    return {**os.environ, "PYTHONPATH": os.pathsep.join(path for path in sys.path if path), **chosen}
