"""A bogie as the unit of estimation: both wheelsets and the frame over a known alignment, for stiff yaw springs."""
