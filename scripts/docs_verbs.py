"""Write docs/cli.md from the commands, docs/glossary.md and docs/specimen-file.md from their words.

python scripts/docs_verbs.py            writes the pages
python scripts/docs_verbs.py --check    exit code 1 where a page is not what would be written
"""

from __future__ import annotations

import argparse
import inspect
import sys
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

import click

from biaxbayes.cli import VERBS, group
from biaxbayes.experiments.experiment import Column, Key
from biaxbayes.options import FIT_DESCRIPTIONS, NO_INTERVAL, WHICH_FIT
from biaxbayes.reports.text import GLOSSARY, SEVERAL_GLOSSARY
from biaxbayes.specimens.keys import COLUMNS, KEYS
from biaxbayes.text_files import atomic_write_text

PAGE = Path(__file__).resolve().parents[1] / "docs" / "cli.md"
WORDS = PAGE.with_name("glossary.md")
SPECIMEN_FILE = PAGE.with_name("specimen-file.md")
HEAD = """# Command line

This page lists every verb with its options; `biaxbayes VERB --help` adds files and examples.
Exit codes: 0 done, 2 an input, option or file that cannot be used, 3 ran but the result cannot be
trusted; 70 a defect of the program; 128 and the number of the signal where one stopped it (130:
Ctrl-C).
"""


SHARED, SHARED_ID = 2, "options-of-several-verbs"
"""Verbs from which an option is explained once; the heading where it is."""


def section(verb: str, common: Sequence[str] = ()) -> str:
    """The reference of one verb: usage, what it does, its options."""
    command = group.get_command(click.Context(group), verb)
    assert command is not None
    context = click.Context(command, info_name=f"biaxbayes {verb}")
    usage = " ".join(["biaxbayes", verb, *command.collect_usage_pieces(context)[1:]])
    parts = [f"## {verb}", f"`{usage}`"]
    first, *_ = inspect.cleandoc(command.help or "").split("\n\n")
    parts.append(first)
    lines = _options(command, context)
    keys = [line for line in lines if verb == "convert" and _is_of_header(line)]
    lines = [line for line in lines if line not in keys]
    own = [line for line in lines if line not in common]
    shared = ", ".join(f"`{_name(line)}`" for line in common if line in lines)
    others = ", ".join(f"`{_name(line)}`" for line in common if line not in lines)
    if keys:
        names = ", ".join(f"`{_name(line)}`" for line in keys)
        own.append(f"- [header keys](specimen-file.md#header-keys) of the file: {names}")
    if len(others) < len(shared):
        shared = f"all but {others}"
    if shared:
        own.append(f"- as [above](#{SHARED_ID}): {shared}")
    return "\n\n".join([*parts, "\n".join(own)])


def _is_of_header(line: str) -> bool:
    """Whether an option writes a header key, which the page of the specimen file explains."""
    key = KEYS.get(_name(line)[2:].replace("-", "_"))
    return key is not None and f": {key.meaning}".lower() in line.lower()


def shared_options() -> list[str]:
    """Lines of options that several verbs have; of each name the most frequent one, if one is."""
    count: Counter[str] = Counter()
    for verb in VERBS:
        command = group.get_command(click.Context(group), verb)
        assert command is not None
        count.update(_options(command, click.Context(command, info_name=f"biaxbayes {verb}")))
    by_name: dict[str, list[int]] = {}
    for line, verbs in count.items():
        by_name.setdefault(_name(line), []).append(verbs)
    most = {name: max(n) if n.count(max(n)) == 1 else 0 for name, n in by_name.items()}
    return [line for line, verbs in count.items() if verbs == most[_name(line)] >= SHARED]


def _name(line: str) -> str:
    """The option of a line, without its value."""
    return line.split("`")[1].split()[0].rstrip(",")


def _options(command: click.Command, context: click.Context) -> list[str]:
    """A line an option, but for --help."""
    lines = []
    for parameter in command.params:
        record = parameter.get_help_record(context)
        if isinstance(parameter, click.Option) and record is not None:
            names, words = (" ".join(part.split()) for part in record)
            if FIT_DESCRIPTIONS["standard"] in words:
                words = "The [fits](glossary.md#the-deterministic-fits). [default: all]"
            names = names.removesuffix(" RANGE")
            lines.append(f"- `{names}`: {words.replace('<', '&lt;')}")  # no tag of HTML
    return lines


def page() -> str:
    """The whole page."""
    common = shared_options()
    shared = "## Options of several verbs\n\n" + "\n".join(common)
    sections = (section(verb, common) for verb in VERBS)
    return "\n\n".join([HEAD.rstrip(), shared, *sections]) + "\n"


COMMON = {
    *("likelihood", "sd of its logarithm", "width", "exponent", "strain energy", "corner plot"),
    *("trace", "sd (standard deviation)", "factor", "mean", "overlay", "ratio", "material laws"),
    *("above zero, below zero", "no verdict, fixed", "median, 90 % interval"),
    *("residual, misfit", "Cauchy stress, nominal stress", "sd between", "verdict"),
    *("misfit of the law", "toe", "contraction"),
    *("convergence", "donor effect", "density of what was left out", "population, group"),
    *("fixed", "P(larger)", "posterior", "prior", "runs", "structure tensor", "trades with"),
    *("not identified", "only in combination", "bounded", "identified", "no verdict"),
    "converged, tentative, unusable",
    *("in sd", "includes 0, includes 1"),
    "Kolmogorov",
    *("ensembles, walkers, steps", "credible band", "predictive band", "stresses to report"),
    *("alone, pooled", "typical donor", "sd of donors, sd of specimens", "new specimen"),
    *("new donor", "weight of a law", "mounting stretch", "other laws"),
}
"""Terms that reports explain, and which are common or stand on other pages."""


ABOUT_TERMS = """# Glossary

This page explains terms of reports and tables that no other page does. Verdicts, bands and
stresses are in [What to report](what-to-report.md), states of a run in [the model](model.md).

"""


def glossary() -> str:
    """The page of terms."""
    known = (GLOSSARY | SEVERAL_GLOSSARY).items()
    terms = "".join(f"| {term} | {words} |\n" for term, words in known if term not in COMMON)
    fits = "".join(f"| `{term}` | {words} |\n" for term, words in FIT_DESCRIPTIONS.items())
    return (
        f"{ABOUT_TERMS}"
        f"| term | meaning |\n|---|---|\n{terms}\n## The deterministic fits\n\n"
        f"| fit | what it does |\n|---|---|\n{fits}\n{WHICH_FIT}{NO_INTERVAL}\n"
    )


ABOUT_SPECIMEN_FILES = """# The specimen file

This page lists the columns and header keys of a specimen file: a CSV in UTF-8 of lines
`# key: value`, a line of column names, then one row per reading. Units are in the names. Numbers
have decimal points; columns and keys come in any order, and unknown ones are refused. A line `#`
without a colon is a comment. `biaxbayes check` shows how a file was understood, `biaxbayes convert`
makes one from a machine's export.

```text
# specimen: sheep 7
# edge_x_mm: 20
# edge_y_mm: 20
# thickness_mm: 0.88
# geometry: unloaded
protocol,stretch_x,stretch_y,force_x_N,force_y_N
1:1,1.000,1.000,0.0151,0.0138
1:1,1.002,1.002,0.0180,0.0157
```
"""
ABOUT_TUBES = """## Tubes

A pressurised tube is stated by `test: tube` ([equations](model.md#tubes)). Dimensions in the
header are those of the tube without pressure and force, to which all stretches refer: a tube has
no mounted state and no rows at rest, and every row counts. Rows in which the wall would fill the
whole outer diameter are refused.

```text
# test: tube
# unloaded_outer_diameter_mm: 8
# unloaded_length_mm: 30
# thickness_mm: 0.9
# opening_angle_fung_deg: 70
# load_noise_kPa: 0.05
# axial_force_noise_N: 0.005
protocol,outer_diameter_mm,length_mm,pressure_mmHg,axial_force_N
1.2,8.42,36,20.4,0.391
1.2,8.81,36,48.9,0.412
```

"""
ABOUT_BULGES = """## Bulge tests

A sheet inflated through a circular clamp is stated by `test: bulge`. It is read at its pole:
the pressure, the stretches of markers there (relative to the unloaded sheet) and the radius of
curvature there, of images from the side or of a surface. With the unloaded thickness T,
Laplace's law gives the tension that the model compares,

```text
p rho / (2 T) = (s_x + s_y) / (2 lx ly)
```

whatever the rest of the sheet and its clamp do. rho is one over the mean of the curvatures in x
and y. Where both stresses and curvatures differ, the product of their half differences is
missed: 1 % where the stress in x is 1.5 times that in y, 7 % where it is 3 times. Noise is that
of the tension.

```text
# test: bulge
# thickness_mm: 0.5
stretch_x,stretch_y,pressure_mmHg,radius_mm
1.05,1.05,30,22
1.10,1.10,70,14
```

**A height is not enough**: the spherical cap of that height is 7 to 22 % more curved than the
pole (membranes of neo-Hookean and exponential laws, to a stretch of 1.5; 11 % for GOH in finite
elements), and the stretch from it, (1 + h^2 / a^2) or the length of the arc, is off by so much
that the pressure of a stiffening tissue would be wrong by 10 % to several times. One bulge test
separates few parameters; beside a square or strips it is a [further piece](pieces.md).

"""
ABOUT_REFERENCES = """## The reference of the stretches

The model needs stretches relative to the mounted state, in which the mounting force is read.
Arrays of NumPy in `Protocol` and `Specimen` are treated in the same way.

- **Each protocol starts at the mounted state** (the default). Its stretches are divided by their
  mean over its first rows.
- **All protocols share one reference** (`common`), for example one gauge length; a protocol may
  then start at (1.03, 1). Rows at stretch (1, 1), or at `mounted_state_x` and `mounted_state_y`,
  give the mounting force, and at least one protocol needs such a row.

Where the first rows of protocols differ by more than 0.002 in stretch, `check`, `sample` and the
report say so. A row is at rest while both stretches rest and no load has begun to rise. A load that
rises while the stretch rests (a camera that lags behind the load cell) is named.
"""


def specimen_file() -> str:
    """The page of columns and header keys."""
    return (
        f"{ABOUT_SPECIMEN_FILES}\n## Columns\n\n{_meanings(COLUMNS)}\n"
        "One pair of forces or stresses is required, and no second one.\n\n"
        f"## Header keys\n\n{_meanings(KEYS)}\n{ABOUT_TUBES}{ABOUT_BULGES}{ABOUT_REFERENCES}"
    )


def _meanings(names: Mapping[str, Column | Key]) -> str:
    """A row a name; x and y together where they mean the same."""
    rows = ["| name | meaning | without it |", "|---|---|---|"]
    for name, entry in names.items():
        if entry.meaning == "The same along y":
            rows[-1] = rows[-1].replace(" |", f", `{name}` |", 1)
        else:
            rows.append(f"| `{name}` | {entry.meaning} | {entry.default} |")
    return "\n".join(rows) + "\n"


def pages() -> dict[Path, str]:
    """Every page that is made here."""
    return {PAGE: page(), WORDS: glossary(), SPECIMEN_FILE: specimen_file()}


def main() -> int:
    """Write or check the pages."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--check", action="store_true")
    if not parser.parse_args().check:
        for path, text in pages().items():
            atomic_write_text(path, text)
        return 0
    stale = [p.name for p, text in pages().items() if p.read_text(encoding="utf-8") != text]
    for name in stale:
        print(f"docs/{name} is not current: run python scripts/docs_verbs.py", file=sys.stderr)
    return 1 if stale else 0


if __name__ == "__main__":
    sys.exit(main())
