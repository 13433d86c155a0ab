"""Vertical stress in block-cave columns: simulate, calibrate, and find the missing physics."""

__version__ = "0.1.0"
