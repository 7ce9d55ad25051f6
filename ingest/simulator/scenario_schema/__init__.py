"""Schema of a scenario file: one class per TOML table, in the units of the file, and its conversion to SI."""
