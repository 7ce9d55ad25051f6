"""What is known of a subject, by facets, each with a version that grows in the transaction that changes it."""

from __future__ import annotations

from enum import StrEnum


class Facet(StrEnum):
    """Base facts of a wheelset, vehicle or section; results of a stage are a facet of the stage's own name."""

    REGISTRY = "registry"  # what is on file, also of the vehicle or class behind it
    RESTARTS = "restarts"  # alerts from which its geometry and trend begin again
    GEOMETRY = "geometry"
