"""Studies of many specimens, in a folder."""
