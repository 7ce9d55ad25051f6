"""What a report of an alignment calls that which was known besides the passes; read again to see what rests on it."""

from __future__ import annotations


def evidence_of_measurement(name: str) -> str:
    """Return what stands for a measurement of wheels."""
    return f"measured profiles of {name}"


def evidence_of_version(source: str, version: int) -> str:
    """Return what stands for an alignment that was known before."""
    return f"{source} version {version}"
