"""Passes of a section in; the next version of its alignment, positions of its windows and a report out."""
