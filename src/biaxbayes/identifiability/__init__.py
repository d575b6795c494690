"""Identifiability: verdicts, and the combinations that the data determine."""
