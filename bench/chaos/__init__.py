"""What operation does to the product, at random but seeded: kills, outages, mistakes, orders, damaged files.

``python -m bench chaos [part ...]`` prints every figure beside what is to be reached.
"""

from bench.chaos.run import main

__all__ = ["main"]
