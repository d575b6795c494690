"""Recompute the method paper, Math. Comput. Appl. 2024, 29(4), 55: tables and figures.

    python scripts/reproduce_paper.py           some minutes on one core
    python scripts/reproduce_paper.py --quick

``docs/paper.md`` quotes them.
"""

from __future__ import annotations

from studies.common import options_of, parser
from studies.paper import claims, figures, tables
from studies.paper.experiments import PRESTRETCHES


def main() -> None:
    """Write all tables and figures in the order of the page."""
    options = options_of(parser(__doc__))
    out, quick = options.out, options.quick
    tables.write_tables34(out)
    tables.write_table5(out)
    tables.write_table6(out)
    figures.figure6(out)
    figures.figure8(out, points=3 if quick else 18)
    claims.write_guesses(
        out, guesses=1 if quick else 20, prestretches=PRESTRETCHES[:1] if quick else PRESTRETCHES
    )
    claims.write_noise(out, replicates=1 if quick else 40)
    claims.write_error_map(out, size=3 if quick else 13)
    claims.write_kappa(out, count=4 if quick else 35)


if __name__ == "__main__":
    main()
