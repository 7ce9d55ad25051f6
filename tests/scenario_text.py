"""A small scenario as text: one vehicle, three wheelsets, two campaigns of twelve seconds."""

from __future__ import annotations

SMALL = """\
name = "small"
description = "three wheelsets, two campaigns of twelve seconds"
seed = 5

[fleet]
code = "F"
name = "Small fleet"

[section]
code = "S-9"
number = 9
name = "Short section"
length_m = 700.0
alignment_std_mm = 1.5
gauge_std_mm = 0.5
survey_alignment_std_mm = 0.1
survey_gauge_std_mm = 0.2

[speed]
lowest_m_s = 15.0
highest_m_s = 22.0

[sensors]
kind = "mems"

[bus]
recorder_clock_offset_s = 2.5

[sessions]
start = 2024-01-08T05:30:00Z
campaigns = 2
minutes_each = 0.2
first_odometer_km = 500.0
km_between = 50000.0
km_per_day = 500.0

[[vehicles]]
code = "V-1"
class = "railcar"
max_speed_km_h = 100.0
axle_offsets_m = [2.0, 4.5, 12.0]

[[vehicles.wheelsets]]
serial = "A"
wear_mm_per_100000_km = 1.0
reprofiled_at_odometer_km = [30000.0]

[[vehicles.wheelsets]]
serial = "B"
wear_left_mm_per_100000_km = 0.5
wear_right_mm_per_100000_km = 0.1
initial_wear_mm = 0.4
initial_mileage_km = 80000.0

[vehicles.wheelsets.fault]
kind = "sensor_fault"
from_campaign = 2

[[vehicles.wheelsets]]
serial = "C"

[vehicles.wheelsets.fault]
kind = "no_transmission"
from_campaign = 1
"""
