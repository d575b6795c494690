"""What the data determine: verdicts, profiles, combinations."""
