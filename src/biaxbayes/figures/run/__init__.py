"""Figures of one run, one file each."""
