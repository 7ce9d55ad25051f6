"""Processes that do units of work: on this machine, or on many through Dask."""
