"""Specimens: what was tested and what was measured; CSV files in, frozen objects out."""
