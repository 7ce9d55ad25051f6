"""Buses of one's own: a DBC file and a mapping file, which of its signals is what.

From the samples on, the code is that of the shipped catalogue.
"""
