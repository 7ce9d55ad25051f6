"""Simulated vehicles that send CAN frames."""
