"""Exchange of runs: a TOML file with axes and units beside a table of signals, from a simulation or a vehicle.

A run becomes a recording on the vehicle's clock, like a log of its bus, and from there on takes the same way.
"""
