"""Estimators compared on the windows of one simulated section."""
