"""The two high-passes in distance: the smoothing spline for windows, the local cubic for passes."""
