"""Studies behind the pages of ``docs/``; ``python scripts/study.py`` lists and runs them."""
