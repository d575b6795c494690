"""The verbs of the command line as functions that give back plain objects."""
