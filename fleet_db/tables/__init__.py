"""Tables, one file a subject; ``Base`` knows them all."""

from fleet_db.tables import alerts, operation, recordings, registry, track, windows
from fleet_db.tables.base import Base

__all__ = ["Base", "alerts", "operation", "recordings", "registry", "results", "track", "windows"]
