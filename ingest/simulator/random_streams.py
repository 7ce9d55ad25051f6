"""Random streams of a scenario: each thing that is drawn has one of its own, whatever else is drawn before it."""

from __future__ import annotations

from enum import IntEnum

import numpy as np


class Stream(IntEnum):
    """First word of the key of a stream; its number decides the recordings of a seed and stays."""

    TRACK = 0
    SPEED = 1  # by vehicle and campaign
    SENSOR = 2  # by vehicle, axle and campaign
    OFFSETS = 3  # of the sensors, by vehicle and axle
    BUS = 4  # by vehicle and campaign
    SURVEY = 5
    POSITION = 6  # by vehicle and campaign
    OTHER_SECTION = 7  # that a wrong survey belongs to
    WEAR = 20  # by wheelset
    CREEP = 21
    VEHICLE = 22  # errors of its parameters, by vehicle
    WHEEL = 23  # file of a measured one, by wheelset
    MEASURED_WHEELSET = 24  # of the bench, by wheelset
    CROSS_LEVEL = 60
    FRICTION = 61  # along the section; of the fleet by campaign
    LOAD = 62
    OUT_OF_ROUND = 63  # phases, by vehicle, axle and campaign
    DIAMETER = 64  # by wheelset
    WHEEL_FLAT = 70  # where on the tread, by vehicle, axle and campaign
    STAMPS = 40  # jitter of each, by vehicle and campaign
    NODE_ERRORS = 41  # scale, mounting and skew of the sensors, by vehicle and axle
    TEMPERATURE = 42  # drift of the sensors, by vehicle, axle and campaign
    ODOMETER = 43  # its scale, by vehicle


def seed_of(seed: int, stream: Stream, *key: int) -> np.random.SeedSequence:
    """Return the seed of one random stream: the same for the same seed of the scenario and key."""
    return np.random.SeedSequence(seed, spawn_key=(stream, *key))


def generator(seed: int, stream: Stream, *key: int) -> np.random.Generator:
    """Return the generator of one random stream."""
    return np.random.default_rng(seed_of(seed, stream, *key))
