"""Benchmarks: each claim of accuracy or speed, with truth or a rival in the same run."""
