"""Deterministic least-squares fits."""
