"""Estimates against what was measured of the same wheels."""
