"""The REST API under load: a fleet of 4,000 wheelsets with a year of daily geometry, 50 clients on loopback.

``python -m bench api`` prints every percentile beside that of a bare endpoint of the same server in the same run.
"""

from bench.api.run import main

__all__ = ["main"]
