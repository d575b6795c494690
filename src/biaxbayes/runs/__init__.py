"""A run folder: written, opened, resumed, locked."""
