"""``python -m biaxbayes``: the same as the command ``biaxbayes``."""

from biaxbayes.cli import main

main()
