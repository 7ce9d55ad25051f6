"""From frames with a recorder's time stamps to samples and windows on the vehicle's clock.

``clock`` finds the instant of every SYNC, ``ticks`` gives every frame the SYNC it belongs to, ``samples`` makes
SampleBlocks of it, ``motion`` knows where and how fast the vehicle was, ``windows`` cuts windows per wheelset.

All of it is local: what a sample becomes depends on frames within :data:`CONTEXT_NS` around it and on nothing else, so
windows that are assembled from every recording that overlaps them do not depend on how the recordings were cut.
"""

from ingest.align.clock import CONTEXT_NS

__all__ = ["CONTEXT_NS"]
