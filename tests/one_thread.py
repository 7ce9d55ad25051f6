"""Linear algebra on one thread, as ``treadwatch`` itself runs it.

Sums over several threads have other last bits, and tests compare bits across processes; threads that wait for each
other on busy cores are slower, too.
"""

from __future__ import annotations

import os

os.environ["OPENBLAS_NUM_THREADS"] = "1"
