"""Identifiability: verdicts, profiles, combinations."""
