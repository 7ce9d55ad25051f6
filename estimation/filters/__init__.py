"""High-passes in distance (smoothing spline for windows, local cubic for passes) and peaks between samples."""
