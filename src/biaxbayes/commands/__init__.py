"""The commands of the command line, one file a verb; imported only when called."""
