"""From frames with a recorder's time stamps to samples and windows on the vehicle's clock.

``clock`` finds the instant of every SYNC and gives it to the frames that belong to it, ``samples`` makes samples per
wheelset of them and the motion of the vehicle, ``windows`` cuts windows per wheelset. All of it is local: what a sample
becomes depends on frames within ``clock.CONTEXT_NS`` around it and on nothing else, so windows that are assembled from
every recording that overlaps them do not depend on how the recordings were cut.
"""
