"""The report of a run: one page that opens anywhere, and tables for a paper."""
