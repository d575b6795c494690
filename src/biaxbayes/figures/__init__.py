"""Figures of a run, one file each: pure functions on plain data."""
