"""Fixtures of the tests of signatures."""

from signature_draws import draw

__all__ = ["draw"]
