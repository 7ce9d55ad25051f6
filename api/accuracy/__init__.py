"""Estimates against measurements, as the API answers them."""
