"""``biaxbayes app``: a page in the browser for the same verbs, on this machine only."""
