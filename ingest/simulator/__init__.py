"""Vehicles that talk CAN."""
