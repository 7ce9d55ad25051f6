"""Passes in; for each pass whether it is used, and why not, out."""
