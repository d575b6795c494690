"""``python -m biaxbayes.cli`` is the command line."""

from biaxbayes.cli import main

if __name__ == "__main__":
    main()
