"""A run whose names try to break the report, sampled once for the tests that read it."""

from dataclasses import replace
from pathlib import Path

import biaxbayes
import quick_posteriors as quick
from biaxbayes.laws.goh import GOH
from biaxbayes.runs.run import Run

NAME = (
    "<script>document.title='broken'</script>\"'><img src=x onerror=alert(1)> "
    "{{ 7*7 }} $x_1$ & 50 % \\end{table} \u05e9\u05dc\u05d5\u05dd | a_b " + "very long " * 40
).strip()
LAYER = "media</style><script>alert(2)</script>"
PROTOCOLS = ("<b onclick='x'>1:1</b>", "a|b & \u0645\u0631\u062d\u0628\u0627", "{% raw %}")


def hostile_run(folder: Path) -> Run:
    """Sample a small specimen with hostile names, a mounted state each protocol."""
    made = quick.specimen(GOH(10.0, 40.0, 5.0, 40.0, 0.1))
    protocols = tuple(
        replace(p, name=name) for p, name in zip(made.protocols, PROTOCOLS, strict=True)
    )
    made = replace(made, name=NAME, layer=LAYER, protocols=protocols)
    with quick.runs_of_few_walkers():
        return biaxbayes.sample(
            made, out=folder, noise="independent", mounting_stretch="per-protocol", ess=100,
            workers=2,
        )  # fmt: skip
