"""Files that a reader meets in the wild, made by code, each with what must come of it."""
