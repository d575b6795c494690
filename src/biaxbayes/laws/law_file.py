"""A law of the user's own, from a Python file with its energy and parameters (docs/laws.md).

Runs keep the text of the file, and a run may come from anywhere. So what is not arithmetic is
refused before anything of the text is run.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from biaxbayes.errors import InputError
from biaxbayes.laws import LAWS, law_named
from biaxbayes.laws.differentiation import COMPOSED, OPERATIONS, exponential
from biaxbayes.laws.law import Law
from biaxbayes.laws.materials import MaterialResponse, exponents
from biaxbayes.parameters import (
    DEGREE,
    GREEK,
    Parameter,
    Quantities,
    fibre_angle,
    positive_parameter,
)

FUNCTIONS = sorted(o.__name__ for o in (*COMPOSED, *OPERATIONS) if isinstance(o, np.ufunc))
ARITHMETIC = (
    *(ast.Module, ast.FunctionDef, ast.arguments, ast.arg, ast.Assign, ast.AugAssign, ast.Return),
    *(ast.Expr, ast.BinOp, ast.UnaryOp, ast.Compare, ast.Call, ast.Name, ast.Constant, ast.Tuple),
    *(ast.Dict, ast.operator, ast.unaryop, ast.cmpop, ast.expr_context),
)
"""What a law can be written with, besides NumPy's functions of numbers."""
MAX_LETTERS, MAX_OPERATIONS = 20_000, 1_000
"""Of a law; one of ten exponentials has some 200 operations."""
TAKEN = {"np", exponential.__name__, *Quantities(()), "lp", "log_likelihood"}
"""Names that a parameter cannot have: of other quantities, and of functions."""
TEST_STRETCHES = np.array([1.02, 1.1, 1.2])


class LawOfFile(Law):
    """A law that a user has written."""

    def bound_tolerances(
        self, material: MaterialResponse, max_stretches: Sequence[np.ndarray]
    ) -> dict[str, float]:
        """Those of every law; a twentieth of range or prior median for what it does not name."""
        own = {
            p.name: 0.05 * (p.high - p.low if p.bounded else p.prior[1])  # type: ignore[index]
            for p in self.parameters
        }
        return own | super().bound_tolerances(material, max_stretches)

    def __reduce__(self) -> Any:
        """Workers make the law from its text, too."""
        return law_named, (self.text,)


@cache
def law_from_text(text: str) -> type[LawOfFile]:
    """The law of a file, by its text; InputError for a text that is none."""
    name = text.partition("\n")[0].removeprefix("#").strip()
    try:
        return _law(text, Path(name).stem)
    except InputError as error:
        raise InputError(error.problem, file=name, remedy=error.remedy) from None


def _law(text: str, name: str) -> type[LawOfFile]:
    found = _evaluated(text)
    table, energy = found.get("parameters"), found.get("energy")
    if not (isinstance(table, dict) and table and callable(energy)):
        raise InputError(
            "a law file has to define a function `energy` and a table `parameters`",
            remedy="see the page on laws",
        )
    parameters = tuple(_parameter(label, prior) for label, prior in table.items())
    wanted = ["X", "Y", "Z", *(f"cos2_{p.name}" if p.mirror else p.name for p in parameters)]
    arguments = list(energy.__code__.co_varnames[: energy.__code__.co_argcount])
    if arguments != wanted:
        raise InputError(
            f"the arguments of `energy` are {', '.join(arguments)}",
            remedy=f"they have to be {', '.join(wanted)}",
        )
    formulas = found.get("exponents", {})
    if not (isinstance(formulas, dict) and set(formulas) <= {p.name for p in parameters}):
        raise InputError('`exponents` has to be like {"k2": "k2 E^2"}, by names of parameters')
    members = {
        "energy": staticmethod(energy),
        "text": text,
        "name": name,
        "title": str(found.get("__doc__") or name).strip().splitlines()[0].rstrip("."),
        "abbreviation": name,
        "source": f"law of the user, {name}.py",
        "description": f"a law of our own ({name})",
        "parameters": parameters,
        "amplitudes": tuple(p.name for p in parameters if p.unit == "kPa"),
        "exponents": formulas,
        # k / k2 (exp(k2 x) - 1) has no value at k2 = 0
        "least": {p.name: 1e-6 for p in parameters if p.logarithmic and p.unit == "1"},
    }
    if name in LAWS:
        raise InputError(f"there is a law {name}", remedy="give the file another name")
    try:
        law = type("LawOfFile", (LawOfFile,), members)
        _check(law())
    except (NameError, TypeError, ValueError, ArithmeticError, RecursionError) as error:
        raise InputError(f"the energy cannot be computed: {error}") from None
    return law


def _evaluated(text: str) -> dict[str, Any]:
    """What a text defines."""
    if len(text) > MAX_LETTERS:
        raise InputError(f"has more than {MAX_LETTERS:,} characters", remedy="write it shorter")
    try:
        tree = ast.parse(text.partition("\n")[2])
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        line = f"line {error.lineno}: " if isinstance(error, SyntaxError) else ""
        raise InputError(f"{line}not valid Python ({getattr(error, 'msg', error)})") from None
    tree.body = [s for s in tree.body if ast.unparse(s) != "import numpy as np"]
    _refuse_more_than_arithmetic(tree)
    numbers = ast.fix_missing_locations(Numbers().visit(tree))
    found: dict[str, Any] = {"__builtins__": {}, "np": np}
    try:
        exec(compile(numbers, "law", "exec"), found)
    except Exception as error:
        raise InputError(f"the file cannot be read: {error}") from None
    return found | {"__doc__": ast.get_docstring(tree)}


class Numbers(ast.NodeTransformer):
    """Makes every number a float, also the truth of a comparison: powers of floats stay small."""

    def visit_Constant(self, node: ast.Constant) -> ast.expr:
        """A whole number as float."""
        return ast.Constant(float(node.value)) if isinstance(node.value, int) else node

    def visit_Compare(self, node: ast.Compare) -> ast.expr:
        """A comparison as 0.0 or 1.0."""
        self.generic_visit(node)
        return ast.BinOp(node, ast.Mult(), ast.Constant(1.0))


def _refuse_more_than_arithmetic(tree: ast.Module) -> None:
    """Refuse what is not arithmetic of numbers, and more of it than a law needs."""
    # Without loops, recursion and functions as values, operations can be counted before anything
    # is run. Texts and tuples, which could grow, are in tables alone.
    functions = {s.name: s for s in tree.body if isinstance(s, ast.FunctionDef)}
    kept: set[int] = {id(s) for s in functions.values()}  # of what is not allowed everywhere
    for node in ast.walk(tree):
        match node:
            case ast.Expr(value=ast.Constant() as docstring):
                kept.add(id(docstring))
            case ast.Call(func=ast.Name() as called):
                kept.add(id(called))
            case ast.Assign(targets=[ast.Tuple() as names], value=ast.Tuple() as values):
                kept |= {id(names), id(values)}
            case ast.Dict():
                rows = [v for v in node.values if isinstance(v, ast.Tuple)]
                kept |= {id(n) for n in (*node.keys, *node.values)}
                kept |= {id(n) for row in rows for n in row.elts if isinstance(n, ast.Constant)}
    for node in ast.walk(tree):
        if _is_refused(node, functions, kept):
            shown = ast.unparse(node).splitlines()[0][:40]
            raise InputError(
                f"line {getattr(node, 'lineno', None)}: `{shown}` is not allowed: a law is "
                "arithmetic",
                remedy="of NumPy it may use np.exp, np.expm1, np.log, np.sqrt and np.maximum",
            )
    cost: dict[str, float] = {}

    def operations(node: ast.AST) -> float:
        """Operations of a part of the text, those of the functions that it calls included."""
        total = 0.0
        for part in ast.walk(node):
            total += isinstance(part, ast.operator | ast.unaryop | ast.Call | ast.Compare)
            if isinstance(part, ast.Call) and isinstance(part.func, ast.Name):
                name = part.func.id
                if name not in cost:
                    cost[name] = float("inf")  # while it is counted: one that calls itself
                    cost[name] = operations(functions[name])
                total += cost[name]
        return total

    if max(map(operations, tree.body), default=0.0) > MAX_OPERATIONS:
        raise InputError(
            f"a function calls itself, or there are more than {MAX_OPERATIONS} operations",
            remedy="write the law in fewer",
        )


def _is_refused(node: ast.AST, functions: Mapping[str, ast.AST], kept: set[int]) -> bool:
    """True for a part of a text that is not arithmetic."""
    match node:
        case ast.Attribute():
            of_numpy = ast.unparse(node.value) == "np"
            return not (of_numpy and node.attr in (*FUNCTIONS, "pi"))
        case ast.Call():
            own = isinstance(node.func, ast.Name) and node.func.id in functions
            return bool(node.keywords) or not (own or isinstance(node.func, ast.Attribute))
        case ast.Name():
            return node.id in functions and id(node) not in kept
        case ast.arg():
            return node.arg in functions
        case ast.FunctionDef():
            more = node.decorator_list or node.args.defaults or node.args.kwonlyargs
            return bool(more) or id(node) not in kept
        case ast.Tuple():
            return id(node) not in kept
        case ast.Constant():
            number = isinstance(node.value, int | float)
            return not (number or (isinstance(node.value, str) and id(node) in kept))
        case ast.UnaryOp():
            return not isinstance(node.op, ast.UAdd | ast.USub)
    return not isinstance(node, ARITHMETIC)


def _parameter(label: object, prior: object) -> Parameter:
    """A parameter from its name with the unit, and its default prior."""
    name, unit = str(label), "1"
    for known in ("kPa", DEGREE):
        if name.endswith(f"_{known}"):
            name, unit = name.removesuffix(f"_{known}"), known
    if not re.fullmatch(r"[A-Za-z][A-Za-z0-9]*(_[A-Za-z0-9]+)*", name) or name in TAKEN:
        raise InputError(
            f"{name[:40]!r} is not a valid name of a parameter",
            remedy="write a name such as k1_kPa that no other quantity has",
        )
    base, below = re.fullmatch("([A-Za-z]+)_?(.*)", name).groups()  # type: ignore[union-attr]
    symbol = f"\\{base}" if f"\\{base}" in GREEK else base
    symbol += f"_{{{below}}}" if below else ""
    match prior:
        case ("lognormal", float(median), float(sd)) if min(median, sd) > 0.0 and unit != DEGREE:
            return positive_parameter(name, symbol, name, unit, median, sd, 1e6, f"no {name}")
        case ("uniform", 0.0, 90.0) if unit == DEGREE:
            return fibre_angle(name, symbol, name)
        case ("uniform", float(low), float(high)) if low < high and unit == "1":
            return Parameter(
                name,
                symbol,
                words=name,
                low=low,
                high=high,
                at_low=f"{name} = {low:g}",
                at_high=f"{name} = {high:g}",
                sharp=0.2 * (high - low),
                width=0.3 * (high - low),
                prior=("uniform", low, high),
            )
        case ("normal", float(mean), float(sd)) if sd > 0.0 and unit == "1":
            return Parameter(
                name,
                symbol,
                words=name,
                sharp=0.1 * sd,
                width=0.1 * sd,
                largest=abs(mean) + 100.0 * sd,
                prior=("normal", mean, sd),
            )
    raise InputError(
        f"parameter {label!s:.40} has no prior",
        remedy='give ("lognormal", median, sd of the log), ("uniform", low, high) or ("normal", '
        'mean, sd); an angle has ("uniform", 0, 90)',
    )


def _check(law: LawOfFile) -> None:
    """Refuse what is not the energy of a material, at medians of the priors and equal stretches."""
    values = {p.name: 0.5 * (p.low + p.high) if p.bounded else p.prior[1] for p in law.parameters}  # type: ignore[index]
    with np.errstate(all="ignore"):
        at_rest = float(law.material(values).strain_energy(1.0, 1.0))
        if not abs(at_rest) < 1e-9 * sum(values[n] for n in law.amplitudes):
            raise InputError(f"the energy is {at_rest:.3g} kPa in the unloaded state; it must be 0")
        if not law.amplitudes:
            raise InputError(
                "the law has no parameter in kPa", remedy="give a stiffness, such as c_kPa"
            )
        for name in law.amplitudes:
            alone = values | dict.fromkeys(law.amplitudes, 0.0)
            one, two = (
                law.material(alone | {name: k}).cauchy(TEST_STRETCHES, TEST_STRETCHES)[0]
                for k in (1.0, 2.0)
            )
            if not np.all(one > 0.0):
                raise InputError(f"the term of {name} gives no tension under equal stretches")
            if not np.allclose(two, 2.0 * one):
                raise InputError(f"the energy is not proportional to {name}, a parameter in kPa")
        constants = law.material(values).constants
        squared = TEST_STRETCHES**2, TEST_STRETCHES**2, TEST_STRETCHES**-4
        if law.exponents and len(exponents(constants, *squared)) != len(law.formulas):
            raise InputError("`exponents` must have one formula for each exponential of the energy")
        for name in law.exponents:
            if not np.all(law.exponent_per_unit(name, constants, *squared) > 0.0):
                raise InputError(f"{name} is not in any exponent of the energy")
