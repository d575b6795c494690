"""What each target of a conversion is read from: a column in its unit, or an expression."""

from __future__ import annotations

import contextlib
import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NoReturn

import numpy as np

from biaxbayes.errors import InputError
from biaxbayes.experiments import BIAXIAL, EXPERIMENTS, Experiment
from biaxbayes.specimens.keys import KEYS
from biaxbayes.tables.expressions import COLUMN, columns_in, evaluated, is_expression, numbers_in
from biaxbayes.tables.question import Question
from biaxbayes.tables.table import MISSING, Table
from biaxbayes.tables.units import (
    FACTORS,
    UNITS,
    Unit,
    is_scaled,
    likely_name,
    names_stretch,
    split_units,
    stem_of,
    unit_named,
    unit_of_column,
    units_of,
    words_of,
)
from biaxbayes.text_files import cell_fault, cells_of, first_few, is_number

STRETCHES = ("stretch_x", "stretch_y")
STRETCH_OF = {
    name: column.stands_for[0]
    for test in EXPERIMENTS.values()
    for name, column in test.columns.items()
    if column.stands_for and column.stands_for[0] in STRETCHES
}
"""The stretch that follows from a column of one kind of test, such as a diameter."""
OF_AXES = tuple((s, *(name for name, of in STRETCH_OF.items() if of == s)) for s in STRETCHES)
"""Targets that the stretches in x and y follow from."""
SHEAR = {"shear_xy": ("f12", "fxy"), "shear_yx": ("f21", "fyx")}
OF_ALL_TESTS = {
    "stretch_x": "stretch", "stretch_y": "stretch", "time_s": "time", "stretch_time_s": "time",
    "protocol": "text", "cycle": "text", "specimen": "text",
}  # fmt: skip
PLANAR_LOADS = {column: name for name, of in BIAXIAL.loads.items() for column in of.columns}
"""Kinds of planar loads by their columns."""
LOAD_PAIRS = [of.columns for test in EXPERIMENTS.values() for of in test.loads.values()]
"""Columns of the loads in x and y, of every kind of test."""
TARGETS = OF_ALL_TESTS | {
    name: unit.quantity if (unit := unit_of_column(name)) else "stretch"
    for name in (*PLANAR_LOADS, *SHEAR, *(c for pair in LOAD_PAIRS for c in pair if c),
                 *STRETCH_OF)
} | dict.fromkeys(SHEAR, "fraction")  # fmt: skip
"""Targets and their quantity."""
OWN_UNITS = {
    "force": "N", "stress": "kPa", "length": "mm", "time": "s", "stretch": "mm/mm",
    "fraction": "mm/mm",
}  # fmt: skip
"""Units that the quantities of targets are in."""
IGNORE = "ignore"
"""Target of columns that mean nothing here."""
OPTIONAL = ("time_s", *SHEAR)
"""Targets that are mapped automatically if a single column of numbers has their name and a unit."""
STRESSES = {
    "piola": (
        "a first Piola-Kirchhoff stress",
        r"piola|pk1|p11|p22|pxx|pyy|first|1st|nominal|engineering|eng",
    ),
    "cauchy": ("a Cauchy stress", r"cauchy|true|(sigma|σ)[xy12]{0,2}|t[xy12]{1,2}"),
    "pk2": (
        "a second Piola-Kirchhoff stress",
        r"pk2|2pk|pkii|kirchhoffii|second|2nd|spk|s[xy12]{1,2}",
    ),
    "kirchhoff": ("a Kirchhoff (or shear) stress", r"(tau|τ)[xy12]{0,2}"),
    "tension": ("a membrane tension", r"t[xy12]{1,2}"),
}
"""Kinds of stress, and the words of a name that suggest one; T11 may be two kinds."""
TO_PIOLA = {"pk2": "{} * ({})", "cauchy": "{} / ({})", "kirchhoff": "{} / ({})"}
"""First Piola-Kirchhoff stress from others and the stretch of their direction, without shear."""
INNER, RADIUS = r"inner|innen|inside|lumen|id", r"radius|rad|r|radii|half"
MEASURES_AGAIN = r"extensomet\w*|clip|laser|video\w*|camera|optical|dic|marker\w*|lvdt"
AXES = (
    {"x": r"x+|circ\w*|horizontal|theta|θ", "y": r"y+|ax\w*|long\w*|vertical|z+"},
    {"x": r"1+", "y": r"2+"},
)
"""Words, or ends of words, of a name that suggest a direction; numbers where no letter does."""
OF_QUANTITY = {
    "stretch": r"strain|dehnung|e|exx|eyy|e11|e22|disp\w*|extension|elongation|stroke|travel|weg",
    "force": r"force|load|f|kraft|fx|fy|cell",
    "stress": r"stress|spannung|p|p11|p22|s11|s22|sigma|pressure",
    "length": r"diameter|od|length|l[äa]nge",
}
"""Words of a column's name that suggest a quantity."""
EXAMPLES = {
    "stretch": "1 + {Disp X (mm)} / 20.6",
    "force": "({Load 1 (mN)} + {Load 2 (mN)}) / 2:mN",
    "pole_tension_kPa": "{P (kPa)} * {Radius of curvature (mm)} / (2 * thickness_mm)",
}
"""Expressions of a target, or of a quantity."""
Header = Mapping[str, object]
"""Values by their key in a specimen file."""
LABELS, ROWS_OF_LABEL = (2, 60), 3
"""Least and largest number of labels that a column of labels has, and the least rows of each."""


@dataclass(frozen=True)
class Source:
    """What a target is read from: a column, or an expression over some."""

    target: str
    text: str  # name of the column, or the expression
    indices: tuple[int, ...]  # of the columns
    unit: Unit | None  # of the column or of the expression's result; None for labels
    computed: bool = False
    conflict: str = ""  # how the unit that the user gives differs from that of the column

    def __str__(self) -> str:
        unit = self.unit
        if unit is None or unit.name == "mm/mm" or (self.computed and unit.factor == 1.0):
            return self.text
        return f"{self.text} ({unit.name})"

    @property
    def formula(self) -> str:
        """The source as a part of an expression."""
        return self.text if self.computed else f"{{{self.text}}}"

    def values(self, table: Table, rows: np.ndarray, header: Header) -> np.ndarray:
        """Values in the unit of the target; NaN where rows are left out and not readable."""
        factor = 1.0 if self.unit is None else self.unit.factor
        if not self.computed:
            return table.values(self.indices[0], rows) * factor
        columns = {name: table.values(table.column(name), rows) for name in columns_in(self.text)}
        constants = {k: float(v) for k, v in header.items() if isinstance(v, int | float)}
        for key in re.findall(r"\b[a-z_]+_mm\b", COLUMN.sub("", self.text)):
            if key in KEYS and key not in header:
                gives = {f"{key}=MM": KEYS[key].meaning}
                problem = f"{self.target} = {self.text[:60]} needs {key}"
                usual = 1 if key == "thickness_mm" else 20
                raise Question(problem, gives, file=table.path, assumed=f"{key}={usual}")
        try:
            values = evaluated(self.text, columns, constants, rows) * factor
        except InputError as error:
            raise table.error(f"{self.target}: {error.problem}", str(error.remedy)) from None
        values = np.broadcast_to(values, (table.rows,))
        bad = rows[~np.isfinite(values[rows])]
        if bad.size:
            problem = f"{self.target} = {self.text[:80]} is not a finite number"
            remedy = "correct the expression, or leave out such rows with `rows`"
            raise table.error(problem, remedy, row=int(bad[0]))
        return np.array(values)


# --- what the user asked for ----------------------------------------------------------------------


def parse_columns(texts: Sequence[str]) -> dict[str, str]:
    """Sources by target from ``target=source,...``; a later text replaces those of an earlier."""
    wanted: dict[str, str] = {}
    for text in texts:
        here: dict[str, str] = {}
        by_quotes = '"' in text and "{" not in text
        pairs = cells_of(text) if by_quotes else re.split(r",(?=\s*\w+\s*=)(?![^{}]*\})", text)
        for pair in (pair for pair in pairs if pair.strip(" ,")):
            target, _, source = (piece.strip() for piece in pair.partition("="))
            if not source:
                problem = f"`columns`: {pair[:60]!r} is not of the form stretch_x=F11"
                raise InputError(problem, remedy="give target=column pairs, separated by commas")
            if target not in (*TARGETS, IGNORE):
                likely, hint = likely_name(target, TARGETS, cutoff=0.7)
                unit = unit_of_column(target)
                if likely and unit is not None and unit != unit_of_column(likely):
                    hint = f"write {likely}={source}:{unit.name}; "
                remedy = f"{hint}targets are {', '.join(TARGETS)}"
                raise InputError(f"`columns`: unknown target {target[:60]!r}", remedy=remedy)
            if target in here and target != IGNORE:
                raise InputError(f"`columns`: {target} is given twice", remedy="keep one")
            here[target] = f"{here[target]}\n{source}" if target in here else source
        kinds = {PLANAR_LOADS[target] for target in here if target in PLANAR_LOADS}
        kept = {
            k: v for k, v in wanted.items() if not kinds or PLANAR_LOADS.get(k) in (None, *kinds)
        }
        ignored = [each[IGNORE] for each in (kept, here) if IGNORE in each]
        wanted = kept | here | ({IGNORE: "\n".join(ignored)} if ignored else {})
    return wanted


def names_needed(sources: Iterable[str]) -> list[list[str]]:
    """For each column of some sources the names that it may have, the longest first."""
    needed = []
    for source in sources:
        plain = _without_unit(source)[0]
        several = [[name] for name in columns_in(source)]
        needed += several if is_expression(plain) else [list(dict.fromkeys((source, plain)))]
    return needed


def side_by_side(
    table: Table, wanted: Mapping[str, str]
) -> dict[str, tuple[dict[str, str], dict[str, str]]]:
    """Sources by protocol, whose name an asterisk stands for; and starred names by the columns."""
    found: dict[str, dict[str, str]] = {}  # columns of a starred name by what the asterisk is
    for *_, name in names_needed(v for k, v in wanted.items() if k != IGNORE):
        if "*" in name and not table.has_column(name):
            pattern = re.escape(name).replace(r"\*", "(.+?)", 1).replace(r"\*", r"\1")
            matches = [(re.fullmatch(pattern, n.strip()), n) for n in table.names]
            found[name] = {match[1]: column for match, column in matches if match}
    lacking = [name for name, columns in found.items() if not columns]
    if lacking and len(lacking) < len(found):
        raise table.error(f"no column {lacking[0][:60]!r} for any text at *", table.listing)
    texts = dict.fromkeys(p for columns in found.values() for p in columns)
    protocols = [p for p in texts if all(p in columns for columns in found.values())]
    ignored = wanted.get(IGNORE, "").split("\n")
    for p in (p for p in texts if protocols and p not in protocols):
        of_one = [columns[p] for columns in found.values() if p in columns]
        if not set(of_one) <= set(ignored):
            absent = next(name for name, columns in found.items() if p not in columns)
            answer = ",".join(f"{IGNORE}={name}" for name in of_one)
            problem = f"{first_few([*map(repr, of_one)], 4)} may be of a protocol {p!r}, which has "
            gives = {f"columns={answer}": f"{p} is left out"}
            raise Question(f"{problem}no {absent!r}", gives, file=table.path)
    sources = {}
    for p in protocols:
        others = [columns[q] for columns in found.values() for q in protocols if q != p]
        mine = dict(wanted)
        for target in wanted:
            for name, columns in found.items():
                mine[target] = mine[target].replace(name, columns[p])
        mine[IGNORE] = "\n".join([*ignored, *others]).strip("\n")
        sources[p] = mine, {columns[p]: name for name, columns in found.items()}
    return sources


def _without_unit(source: str) -> tuple[str, Unit | None]:
    """A source without the unit behind its last colon, and that unit."""
    name, colon, ending = source.rpartition(":")
    unit = unit_named(ending) if colon else None
    return (source, None) if unit is None else (name.strip(), unit)


def targets_of(test: str | None) -> list[str]:
    """Targets of a kind of test as a specimen file names it; of a biaxial one without a name."""
    kind = EXPERIMENTS[test or "biaxial"]
    others = {of.columns[k] for of in kind.loads.values() for k in kind.axes}
    others |= (kind.columns.keys() & STRETCH_OF.keys()).union(SHEAR if kind.is_biaxial else ())
    return [t for t in TARGETS if t in OF_ALL_TESTS or t in others]


@dataclass(frozen=True)
class Columns:
    """The columns of a table, and what a user said that they are."""

    table: Table
    wanted: Mapping[str, str]  # sources by target
    header: Header
    test: str | None = None  # as a specimen file names it; a biaxial one if it is not stated

    @property
    def experiment(self) -> Experiment:
        """The kind of test."""
        return EXPERIMENTS[self.test or "biaxial"]

    def sources(self) -> dict[str, Source]:
        """The source of each target: as the user said, or a column that is named as the target."""
        table, wanted, targets = self.table, self.wanted, targets_of(self.test)
        for target in (t for t in wanted if t not in (*targets, IGNORE)):
            others = [name for name in EXPERIMENTS if target in targets_of(name)]
            if self.test is None and others:
                gives = {f"test={name}": EXPERIMENTS[name].words for name in others}
                raise Question(f"{target} is read from a {others[0]}", gives, file=table.path)
            problem = f"`columns`: {target} is not read from a {self.test or 'biaxial'} test"
            remedy = f"leave it out, or give another `test`; it reads {', '.join(targets)}"
            raise table.error(problem, remedy)
        for text in (text for target, text in wanted.items() if target != IGNORE):
            if not any(table.has_column(name) for name in (text, _without_unit(text)[0])):
                self._check_braces(text)
                for names in names_needed([text]):
                    table.column(names[-1])  # says so if there is none
        ignored = {table.column(name) for name in wanted.get(IGNORE, "").split("\n") if name}
        # a reading that a file may lack is read where it is, whatever else is said
        named = not any(of.optional for of in self.experiment.loads.values())
        named = named and any(TARGETS.get(t) in ("force", "stress") for t in wanted)
        sources: dict[str, Source] = {}
        for target in targets:
            if target in wanted:
                sources[target] = self.said(target)
            elif not (named and TARGETS[target] in ("force", "stress")):
                index = self._by_name(target)
                if index is not None and index not in ignored:
                    with contextlib.suppress(*[InputError] * (target in OPTIONAL)):
                        sources[target] = self._column(target, index, None)
        self._check_complete(sources)
        used = {i for source in sources.values() for i in source.indices} | ignored
        unused = [i for i in range(len(table.names)) if i not in used]
        self._ask_about_labels(sources, unused)
        self._ask_about_opposites(sources, unused)
        return sources

    def _check_braces(self, text: str) -> None:
        """Refuse an expression whose columns stand without braces."""
        inside = max((n for n in self.table.names if n in text), key=len, default="")
        if inside and "{" not in text and re.search(r"[-+*/(]", text.replace(inside, "")):
            plain = text.replace(f"[{inside}]", inside).replace(inside, f"{{{inside}}}")
            remedy = f"columns of an expression stand in braces: {plain}"
            raise self.table.error(f"no column {text[:60]!r}", remedy)

    def said(self, target: str) -> Source:
        """The source of a target as the user gave it: an expression, a column, or a column:unit."""
        table, text = self.table, self.wanted[target]
        source, unit = _without_unit(text)
        if not table.has_column(text) and is_expression(source):
            return self._expression(target, source, unit)
        name, given = (text, None) if text in table.names or unit is None else (source, unit)
        return self._column(target, table.column(name), given)

    def _by_name(self, target: str) -> int | None:
        """The column that is named as a target, in any unit."""
        table = self.table
        if target not in OPTIONAL:
            return table.by_stem(stem_of(target))
        stems = (stem_of(target), *SHEAR.get(target, ()))
        same = [i for i, name in enumerate(table.names) if stem_of(name) in stems]
        numeric = len(same) == 1 and table.finite(same[0]).size == table.rows
        return same[0] if numeric else None

    def _ask(
        self,
        target: str,
        problem: str,
        formulas: Mapping[str, str],
        *,
        likely: bool = True,
        assumed: str = "",
        other: bool = True,
    ) -> NoReturn:
        """Ask for the source of a target, another column among the answers."""
        before = f"columns={target}="
        whole = ("columns=", "test=")
        gives = {k if k.startswith(whole) else before + k: v for k, v in formulas.items()}
        if other:
            gives[f"{before}COLUMN"] = f"another column; {self.table.listing}"
        assumed = before + assumed if assumed else ""
        raise Question(problem, gives, file=self.table.path, likely=likely, assumed=assumed)

    def _expression(self, target: str, text: str, given: Unit | None) -> Source:
        """An expression; its result is in the target's unit, or in the one behind a colon."""
        table, quantity = self.table, TARGETS[target]
        if quantity == "text":
            remedy = f"name a column of labels, as {target}=Name; {table.listing}"
            raise table.error(f"{target} cannot be computed", remedy)
        indices = tuple(table.column(name) for name in columns_in(text))
        of_columns = {next((u.quantity for u in table.units(i)), "") for i in indices}
        if quantity == "stretch" and of_columns and of_columns <= {"force", "stress", "time"}:
            remedy = f"a stretch follows from lengths, positions or strains; {table.listing}"
            of = "a time" if of_columns == {"time"} else "a load"
            raise table.error(f"{target} = {text[:60]} is computed from {of} alone", remedy)
        own = UNITS[OWN_UNITS[quantity]]
        fits = quantity if quantity in FACTORS else "fraction"
        if given is not None and given.quantity != fits:
            remedy = f"units are {units_of(fits)}; without a colon it is in {own.name}"
            raise table.error(f"{target} is not in {given.name}", remedy)
        if given is None and quantity in ("force", "stress", "length"):
            for index in indices:
                self._ask_about_unit_of_result(target, text, index)
        return Source(target, text, indices, given or own, computed=True)

    def _ask_about_unit_of_result(self, target: str, text: str, index: int) -> None:
        """Ask where a column is in another unit than the result, or converted for nothing."""
        quantity, unit, own = TARGETS[target], self.table.unit(index), OWN_UNITS[TARGETS[target]]
        if unit is None or unit.quantity not in (quantity, "force"):
            return
        # force over mm2 is a stress: of N in MPa, of mN in kPa
        over = "over mm2 " if unit.quantity != quantity else ""
        factor = 1e3 * unit.factor if over else unit.factor
        numbers = np.array([1.0, *filter(None, numbers_in(text))])
        converts = np.isclose([numbers, 1.0 / numbers], factor, rtol=1e-2).any()
        problem = f"{self.table.names[index]!r} is in {unit.name}, {over}which gives "
        if factor == 1.0 and np.isclose(np.abs(np.log10(numbers)), 3.0).any():
            alone = {self.table.reference(index): f"the column as it is, in {own}"}
            gives = alone if len(columns_in(text)) == 1 else {}
            why = f"{own} already, and {text[:60]!r} converts it"
        elif not converts:
            units = [name for name, size in FACTORS[quantity].items() if size == factor][:1]
            gives = {f"{text}:{name}": f"the result is in {name}" for name in units}
            why = f"no {own}, and no number in {text[:60]!r} converts it"
        else:
            return
        gives[f"{text}:{own}"] = f"the result is in {own} as it stands"
        self._ask(target, problem + why, gives, other=False)

    def _column(self, target: str, index: int, given: Unit | None) -> Source:
        """A column by its name, in the unit of its name or the given one; asks where it is open."""
        table, quantity = self.table, TARGETS[target]
        name, text = table.names[index], table.reference(index)
        if quantity == "text":
            return Source(target, text, (index,), None)
        if not table.finite(index).size:
            fault, _ = cell_fault(next(filter(None, table.text(index)), ""))
            remedy = f"name a column of readings; {table.listing}"
            raise table.error(f"no number in column {text!r}: {fault}", remedy)
        if quantity == "stretch":
            return self._stretch(target, index, given)
        if target in PLANAR_LOADS and quantity == "stress":
            self._ask_about_kind_of_stress(target, index, given)
        if quantity == "length":
            self._ask_about_other_length(target, index)
        if target == "pole_tension_kPa" and _is_pressure(name):
            shown = given or table.unit(index) or UNITS["kPa"]
            gives = {"EXPRESSION": f"such as {EXAMPLES[target]}:{shown.name}"}
            gives[f"{{{text}}}:{shown.name}"] = "it is the tension of the pole"
            problem = f"{name!r} is a pressure, and {target} is pressure times radius of curvature"
            problem += " over twice the thickness"
            self._ask(target, problem, gives, likely=False, other=False)
        unit, unknown = given or table.unit(index), table.unknown_unit(index)
        if unit is None and not unknown and quantity in ("time", "fraction"):
            unit = UNITS[OWN_UNITS[quantity]]
        if unit is None or unit.quantity != quantity or unit.name == "px":
            problem = f"the unit of {name!r} is not known"
            if unit is not None:
                problem = f"{name!r} is in {unit.name}, a unit of {unit.quantity}, and {target} is "
                problem += f"a {quantity}"
            elif unknown:
                problem = f"{unknown!r} of {name!r} is not a known unit"
            self._ask_for_unit(target, index, problem)
        if is_scaled(name) and given is None:
            gives = {f"{text}:{unit.name}": f"they are plain values in {unit.name}"}
            gives[f"{{{text}}} * FACTOR"] = "they are converted by a factor"
            problem = f"the name {name!r} suggests a multiple, a power, an inverse or a rate"
            self._ask(target, problem, gives, other=False)
        others = {u.name for u in table.units(index) if u.quantity == quantity} - {unit.name}
        conflict = f"{target} is read in {unit.name}, as given; {name!r} says {', '.join(others)}"
        return Source(target, text, (index,), unit, conflict=conflict if others else "")

    def _ask_for_unit(self, target: str, index: int, problem: str) -> NoReturn:
        """Ask for the unit of a column, with the largest value in each."""
        quantity, name = TARGETS[target], self.table.reference(index)
        largest = np.abs(self.table.finite(index)).max()
        usual = {"force": ("N", "mN", "gf"), "stress": ("kPa", "MPa", "Pa", "mmHg")}
        units, own = usual.get(quantity, tuple(FACTORS[quantity])[:4]), OWN_UNITS[quantity]
        low, high = (1e-3, 50.0) if quantity == "force" else (0.1, 2000.0)
        values = {unit: largest * UNITS[unit].factor for unit in units}
        gives = {f"{name}:{u}": f"its largest value is {v:.4g} {own}" for u, v in values.items()}
        gives[f"{name}:UNIT"] = f"one of {units_of(quantity)}"
        likely = next((unit for unit, value in values.items() if low <= value <= high), units[0])
        self._ask(target, problem, gives, likely=False, assumed=f"{name}:{likely}")

    def _ask_about_other_length(self, target: str, index: int) -> None:
        """Ask where the name of a diameter or length suggests an inner one, a radius or a wall."""
        name, outer, wall = self.table.names[index], "unloaded_outer_diameter_mm", "thickness_mm"
        found = _words(name, rf"{INNER}|{RADIUS}|wall|thickness")
        if not found:
            return
        unit = next((u for u in self.table.units(index) if u.quantity == "length"), UNITS["mm"])
        column = f"{{{self.table.reference(index)}}}"
        column += f" * {unit.factor:g}" if unit.factor != 1.0 else ""
        doubled = f"2 * {column}" if _words(name, RADIUS) else column
        gives = {doubled: "twice the radius"} if doubled != column else {}
        if _words(name, INNER) and target == "outer_diameter_mm":
            # the wall keeps its volume: (do^2 - di^2) lz = Do^2 - (Do - 2 H)^2
            section = f"4 * {wall} * ({outer} - {wall})"
            label = "the outer diameter of a wall that keeps its volume, at an axial stretch such "
            label += "as ({Length (mm)} / unloaded_length_mm)"
            gives = {f"sqrt(({doubled})**2 + {section} / AXIAL_STRETCH)": label}
        gives[column] = f"it is the {target.rpartition('_')[0].replace('_', ' ')}"
        problem = f"{name!r} says {found}, and {target} is read from it"
        self._ask(target, problem, gives, likely=False)

    def _ask_about_kind_of_stress(self, target: str, index: int, given: Unit | None) -> None:
        """Ask where the name of a stress suggests another kind than its target."""
        name, (pair, axis, _) = self.table.names[index], target.split("_")
        words = words_of(name)
        words += [first + second for first, second in pairwise(words)]
        own, unit = STRESSES[pair][0], given or self.table.unit(index)
        is_tension = unit is not None and unit.quantity == "membrane tension"
        kinds = {
            k: kind
            for k, (kind, pattern) in STRESSES.items()
            if any(re.fullmatch(pattern, w) for w in words) and (k == "tension" or not is_tension)
        }
        text = self.table.reference(index)
        if not kinds or [*kinds] == [pair]:
            return
        factor = f":{unit.name}" if unit is not None and unit.quantity == "stress" else ":kPa"
        said = self.wanted.get(f"stretch_{axis}", f"stretch_{axis}")
        stretch = said if is_expression(_without_unit(said)[0]) else f"{{{said}}}"
        gives = {}
        for k, kind in kinds.items():
            if k in TO_PIOLA and pair == "piola":
                formula = TO_PIOLA[k].format(f"{{{text}}}", stretch)
                gives[formula + factor] = f"first Piola-Kirchhoff from {kind}"
            if k == "tension":
                gives[f"{{{text}}} / thickness_mm"] = f"{kind} in N/m over the thickness"
        gives[f"{{{text}}}{factor}"] = f"it is {own}"
        both = {t: s for t, s in self.wanted.items() if PLANAR_LOADS.get(t) == pair}
        plain = [_without_unit(s)[0] for s in both.values()]
        computed = any(is_expression(s) and not COLUMN.fullmatch(s) for s in plain)
        for k in (k for k in kinds if k in BIAXIAL.loads and k != pair and not computed):
            # both loads are of the other kind, and none is converted from it
            moved = (f"{t.replace(pair, k)}={s}" for t, s in (both or {target: text}).items())
            gives[f"columns={','.join(moved)}"] = f"it is {kinds[k]}"
        problem = f"the name {name!r} suggests {' or '.join(kinds.values())}, and {target} is {own}"
        # what is assumed of one load must not be in the proposals for the other
        kept = f"{{{text}}}{factor}" if [*kinds] != ["tension"] else ""
        self._ask(target, problem, gives, likely=False, assumed=kept)

    def _stretch(self, target: str, index: int, given: Unit | None) -> Source:
        """A column of stretches; asks how the stretch follows from any other."""
        table, name, values = self.table, self.table.names[index], self.table.finite(index)
        units = [u for u in table.units(index) if u.quantity != "fraction" or u.factor != 1.0]
        start, extent = float(values[0]), float(np.ptp(values))
        plain = not units and given is None and not table.unknown_unit(index)
        low, high = 0.5, 1.7  # values that a stretch may begin with
        is_stretch = names_stretch(name, table.below(index)) and not is_scaled(name)
        if plain and is_stretch and low < start < high:
            return Source(target, table.reference(index), (index,), UNITS["mm/mm"])
        column, stated = f"{{{table.reference(index)}}}", [given] if given else units
        length = next((u for u in stated if u.quantity == "length"), None)
        turned = abs(values.min() - start) > abs(values.max() - start)
        sign = "-" if turned else "+"
        lengths = formulas = self._of_a_length(target, column, sign, start, extent, length)
        if length is None:
            share = next((u.factor for u in stated if u.quantity == "fraction"), 1.0)
            e = column if share == 1.0 else f"{column} * {share:g}"
            strains = {
                f"1 + {e}": "engineering strain",
                f"sqrt(1 + 2 * {e})": "Green-Lagrange strain",
                f"exp({e})": "logarithmic (true, Hencky) strain",
                f"1 / sqrt(1 - 2 * {e})": "Almansi strain",
            }
            moves = _words(name, r"disp(lacement)?s?|extension|elongation|travel|stroke")
            formulas = strains | lengths if not moves else lengths | strains
            if low < share * start < high:
                formulas = {e: "stretch"} | lengths
        what = f"is in {length.name}" if length is not None else f"starts at {start:g}"
        certain = length is None or start > 2.0 * extent
        # so that what else is open can be asked
        near = "" if certain else f"1 {sign} {column} / {max(4.0 * extent, 1e-12):.6g}"
        of = "" if column == f"{{{name}}}" else f" ({table.reference(index)})"
        problem = f"{name!r}{of} {what}: how does {target} follow from it?"
        self._ask(target, problem, formulas, likely=certain, assumed=near)

    def _of_a_length(
        self, target: str, column: str, sign: str, start: float, extent: float, unit: Unit | None
    ) -> dict[str, str]:
        """Stretches from a displacement, or from the distance of marks or grips."""
        of, over = "the length between marks or grips", "/ LENGTH_MM"
        moved = f"({column} - first({column}))" if abs(start) > 0.01 * extent else column
        displaced = {f"1 {sign} {moved} {over}": f"a displacement, over {of} in the first row"}
        at_zero = f"a displacement, over {of} where it is zero"
        displaced.setdefault(f"1 {sign} {column} {over}", at_zero)  # where it starts elsewhere
        edge = "unloaded_length_mm" if target == "stretch_z" else f"edge_{target[-1]}_mm"
        if edge in self.header and unit is not None and unit.name != "px":
            scale = "" if unit.factor == 1.0 else f" * {unit.factor:g}"
            displaced[f"1 {sign} {moved}{scale} / {edge}"] = f"a displacement over {edge}"
        first = {f"{column} / first({column})": f"a distance, over its first value {start:g}"}
        distance = first if start > 0.0 else {}
        distance[f"{column} {over}"] = f"a distance, over {of}, unloaded or mounted"
        # a distance is longer than it changes
        return (distance | displaced) if start > 2.0 * extent else (displaced | distance)

    def _check_complete(self, sources: dict[str, Source]) -> None:
        """Ask for missing stretches and loads; refuse two of one, and two kinds of loads."""
        table, wanted = self.table, self.wanted
        for name, standard in STRETCH_OF.items():
            if name not in sources or standard not in sources:
                continue
            if standard not in wanted and name in wanted:
                del sources[standard]
            elif name not in wanted and sources[name].indices == sources[standard].indices:
                del sources[name]
            else:
                names = f"{sources[name].text!r} and {sources[standard].text!r}"
                remedy = f"keep one, and write --columns {IGNORE}=COLUMN for the other"
                raise table.error(f"{names} both give {standard}", remedy)
        kinds = self.experiment.loads
        pairs = [p for p, of in kinds.items() if any(name in sources for name in of.columns)]
        if len(pairs) > 1:
            raise table.error("loads of more than one kind", f"map one of them; {table.listing}")
        if missing := self._missing(sources, pairs):
            self._ask_for_columns(missing, sources, bool(pairs))
        used: dict[int, str] = {}
        for target, source in sources.items():
            if source.computed or (first := used.setdefault(source.indices[0], target)) == target:
                continue
            problem = f"{source.text!r} is used for both {first} and {target}"
            if TARGETS[target] == "text" or TARGETS[first] != TARGETS[target]:
                raise table.error(problem, table.listing)
            self._ask(target, problem, {source.formula: f"it serves {first} as well"})
        for pair in pairs if PLANAR_LOADS.keys() & sources.keys() else ():
            of_axes = (*STRETCHES, *kinds[pair].columns)
            self._ask_about_swapped(*(sources[t] for t in of_axes if t in sources))

    def _ask_about_swapped(self, *columns: Source) -> None:
        """Ask where the names of both loads suggest the direction of the other stretch."""
        if len(columns) < 4 or any(c.computed for c in columns):
            return
        x, y, of_x, of_y = (_directions(self.table.names[c.indices[0]]) for c in columns)
        if x == of_y != y == of_x and len(x) == len(y) == 1:
            (_, _, first, second), unit = columns, columns[2].unit
            swapped = f"columns={first.target}={second.text},{second.target}={first.text}"
            kept = ",".join(f"{c.target}={c.formula}:{unit.name}" for c in (first, second))  # type: ignore[union-attr]
            gives = {swapped: "the other way round", f"columns={kept}": "as it is said"}
            problem = f"{columns[0].text!r} and {second.text!r} are of one direction by their "
            problem += f"names, and {first.text!r} is said to be"
            self._ask(first.target, problem, gives, likely=False)

    def _missing(self, sources: Mapping[str, Source], pairs: Sequence[str]) -> list[str]:
        """Targets that the test needs, of the likely loads, and that have no source."""
        kind = self.experiment
        likely = [p for p, of in kind.loads.items()
                  if any(self.likely_columns(t, sources) for t in of.columns if t)]  # fmt: skip
        loads = kind.loads[[*pairs, *likely, *kind.loads][0]]
        given = {STRETCH_OF.get(name, name) for name in sources}
        needed = [f"stretch_{axis}" for k, axis in enumerate("xy") if k != kind.free_side]
        needed += [loads.columns[k] for k in kind.axes if k not in loads.optional]
        lengths = {STRETCH_OF[t]: t for t in targets_of(self.test) if TARGETS[t] == "length"}
        lengths = {t: name for t, name in lengths.items() if self.likely_columns(name, sources)}
        return [lengths.get(t, t) for t in needed if t not in given]

    def likely_columns(self, target: str, sources: Mapping[str, Source]) -> list[int]:
        """Columns that may be read for a target by unit and name, the likeliest first."""
        quantity, used = TARGETS[target], {i for s in sources.values() for i in s.indices}
        own = {"length", "fraction"} if quantity == "stretch" else {quantity}
        scored = []
        for index, name in enumerate(self.table.names):
            values = self.table.finite(index)
            no_tension = target == "pole_tension_kPa" and _is_pressure(name)
            if index in used or no_tension or values.size < 2 or np.ptp(values) == 0.0:
                continue
            units = {u.quantity for u in self.table.units(index)}
            fits = bool(units & own) or (quantity == "stretch" and names_stretch(name, ""))
            fits = fits or (not units and bool(_words(name, OF_QUANTITY.get(quantity, "-"))))
            if fits and not units - own:
                directions = _directions(name)
                scored.append((_axis_of(target) not in directions, len(directions) == 1, index))
        return [index for *_, index in sorted(scored)]

    def _ask_for_columns(
        self, missing: Sequence[str], sources: Mapping[str, Source], has_loads: bool
    ) -> NoReturn:
        """Ask what the first missing target is read from, or whether the test is another one."""
        table, target = self.table, missing[0]
        likely = self.likely_columns(target, sources)[:8]
        ranges = ((table.reference(i), table.finite(i)) for i in likely)
        columns = {name: f"from {v.min():.4g} to {v.max():.4g}" for name, v in ranges}
        others = {}
        for axis, across in ("xy", "yx") if self.test is None else ():
            along = [t for t in sources if f"_{axis}" in t and t not in SHEAR]
            if len(along) == len(missing) == 2 and all(f"_{across}" in t for t in missing):
                others[f"test=strip {axis}"] = f"a strip pulled along {axis}, whose sides are free"
        planar = has_loads or any(key.startswith("edge") for key in self.header)
        if self.test is None and not planar and any(map(_is_pressure, table.names)):
            inflated = {n: e for n, e in EXPERIMENTS.items() if "pressure_kPa" in e.columns}
            others |= {f"test={name}": e.words for name, e in inflated.items()}
        stretches = [s for t, s in sources.items() if TARGETS[t] == TARGETS[target] == "stretch"]
        both = {s.formula: "the same for both directions" for s in stretches[:1]}
        certain = any(_axis_of(target) in _directions(table.names[i]) for i in likely)
        gives = columns | others | both if certain or not others else others | columns | both
        example = EXAMPLES.get(target, EXAMPLES.get(TARGETS[target]))
        gives["EXPRESSION"] = f"such as {example}" if example else "columns in braces, as {#3}"
        problem = f"no column for {' and '.join(missing) if others else target}; {table.listing}"
        self._ask(target, problem, gives, likely=bool(likely or others), other=False)

    def _ask_about_labels(self, sources: Mapping[str, Source], unused: Sequence[int]) -> None:
        """Ask what a column separates that has the same few labels in many rows."""
        table = self.table
        for index in unused:
            cells = table.text(index)
            labels = [cell for cell in cells if cell.lower() not in MISSING]
            counts = Counter(labels)
            numbers = all(map(is_number, counts))
            whole = all(re.fullmatch(r"\d+(\.0*)?", label) for label in counts)
            reading = any(u.quantity != "fraction" for u in table.units(index))
            merged = 2 * len(labels) < table.rows
            # numbers may be readings, such as a coarse temperature; words may alternate
            changes = sum(a != b for a, b in pairwise(labels)) + 1 if numbers else len(counts)
            often = changes * ROWS_OF_LABEL > (table.rows if merged else len(labels))
            few = LABELS[0] <= len(counts) <= LABELS[1]
            if not few or (numbers and not whole) or reading or often or (merged and not cells[0]):
                continue
            shown = first_few([f"{label}: {count} rows" for label, count in counts.items()], 6)
            text = table.reference(index)
            gives = {f"columns={target}={text}": f"each a {target}"
                     for target in ("protocol", "cycle") if target not in sources}  # fmt: skip
            if "specimen" not in sources:
                gives[f"specimen_by={text}"] = "each a specimen"
            ignored = f"columns={IGNORE}={text}"
            gives[ignored] = "nothing"
            problem = f"column {text!r} has {len(counts)} labels ({shown}), and nothing says what "
            problem += "they separate"
            raise Question(problem, gives, file=table.path, likely=False, assumed=ignored)

    def _ask_about_opposites(self, sources: Mapping[str, Source], unused: Sequence[int]) -> None:
        """Ask for the other actuator or cell of a direction, where unused columns move alike."""
        table = self.table
        for target, source in sources.items():
            quantity = {"stretch": "length", "force": "force"}.get(TARGETS[target])
            own = [i for i in source.indices if quantity in [u.quantity for u in table.units(i)]]
            if len(own) != 1 or target in ("stretch_z", "axial_force_N"):
                continue
            alike = {i: r for i in unused if (r := _moves_alike(table, own[0], i, str(quantity)))}
            if not alike:
                continue
            name, others = table.reference(own[0]), [table.reference(i) for i in alike]
            column, gives = f"{{{name}}}", {}
            unit = "" if source.computed else f":{source.unit.name}"  # type: ignore[union-attr]
            for other, correlation in zip(others, alike.values(), strict=True):
                total = f"({column} {'+' if correlation > 0.0 else '-'} {{{other}}})"
                ways = {total: "both ends move"}
                if quantity == "force":
                    ways = {f"({total} / 2)": "cells at both ends: their mean",
                            total: "cells side by side: their sum"}  # fmt: skip
                for both, label in ways.items():
                    gives[source.formula.replace(column, both) + unit] = label
            ignore = ",".join(f"{IGNORE}={other}" for other in others)
            gives[f"columns={ignore}"] = "they are of other parts or protocols, or of a fixed end"
            what = "displacement of" if quantity == "length" else "cell at"
            listed = first_few([repr(k) for k in others], 4)
            problem = f"{listed} may be the {what} the other end of {name!r}"
            self._ask(target, problem, gives, likely=False, other=False)


# --- words of names -------------------------------------------------------------------------------


def _words(name: str, pattern: str) -> str:
    """The words of a name that match a pattern."""
    words = words_of(name)
    words += [re.sub(r"[xy12]$", "", word) for word in words]
    return " ".join(dict.fromkeys(word for word in words if re.fullmatch(pattern, word)))


def _directions(name: str, axes: Sequence[Mapping[str, str]] = AXES) -> set[str]:
    """Directions that the words of a name suggest."""
    parts = words_of(split_units(name)[0])
    words = [w for part in parts for w in (part, part[-1:], part[-2:], part[:1])]
    for of in axes:
        if found := {a for a in "xy" if any(re.fullmatch(of[a], word) for word in words)}:
            return found
    return set()


def _axis_of(target: str) -> str:
    of_y = (*OF_AXES[1], *(y for _, y in LOAD_PAIRS))
    return "y" if target in of_y or "_y" in target else "x"


def _is_pressure(name: str) -> bool:
    unit = unit_of_column(name)
    return "pressure" in words_of(name) or (unit is not None and unit.name in ("mmHg", "cmH2O"))


def _moves_alike(table: Table, own: int, other: int, quantity: str) -> float:
    """Correlation of a column with one that may be of the other end; zero for any other."""
    # numbers alone may count the cells
    here, there = (_directions(table.names[k], AXES[:1]) for k in (own, other))
    # an extensometer or a camera measures the same move in another way
    again = _words(f"{table.names[own]} {table.names[other]}", MEASURES_AGAIN)
    apart = again or (here and there and not here & there)
    if apart or quantity not in [u.quantity for u in table.units(other)]:
        return 0.0
    curves = np.array([table.sparse_numbers(k, texts=True) for k in (own, other)])
    curves = curves[:, np.isfinite(curves).all(axis=0)]
    extent, moved = np.ptp(curves, axis=1) if curves.shape[1] > 2 else (0.0, 0.0)
    # a distance has no other end, and a position no displacement
    away = extent and bool(curves[0, 0] > 2.0 * extent or np.abs(curves[1, 0]) > moved)
    if (away and quantity == "length") or not 0.5 * extent < moved < 2.0 * extent:
        return 0.0
    return float(np.corrcoef(curves)[0, 1])
