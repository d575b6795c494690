"""Tables in, figures out: pure functions on plain data."""
