"""Runs that are killed, starved of space and locked out, and what is left of them."""
