"""A section scenario small enough for tests."""

SMALL_SECTION = """\
name = "small"
description = "two vehicles on two kilometres"

[fleet]
vehicles = 2
wheelsets = 2
passes = 2

[section]
length_m = 2000.0
alignment_std_mm = 2.0

[speed]
lowest_m_s = 18.0
highest_m_s = 25.0

[sensors]
kind = "mems"

[known]
position_offset_m = 20.0
position_scale_percent = 0.1

[vehicle_errors]
drawn = false

[[pairs]]
name = "P8/113A"
wheel_profile = "P8"
rail_profile = "56E1"
deepest_wear_mm = 1.2

[[pairs]]
wheel_profile = "S1002"
rail_profile = "60E1"
rail_inclination_1_in = 40.0
deepest_wear_mm = 0.6
"""
