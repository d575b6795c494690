"""Arithmetic over columns, such as ``1 + {Disp X (mm)} / 20.6``.

Numbers, names, operators and functions as listed here, and nothing else: no code of a file runs.
"""

from __future__ import annotations

import ast
import operator
import re
import warnings
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from simpleeval import InvalidExpression, SimpleEval

from biaxbayes.errors import InputError

COLUMN = re.compile(r"\{([^{}]*)\}")
LONGEST = 1000
"""Letters of an expression."""
FUNCTIONS: dict[str, Callable[[Any], Any]] = {
    "sqrt": np.sqrt, "exp": np.exp, "log": np.log, "abs": np.abs, "sin": np.sin, "cos": np.cos,
}  # fmt: skip
"""Functions of one value; log is the natural one."""
FIRST = "first"
"""Function of the value in the first row that is read."""
OPERATORS: dict[type, Callable[..., Any]] = {
    ast.Add: operator.add, ast.Sub: operator.sub, ast.Mult: operator.mul,
    ast.Div: operator.truediv, ast.Pow: operator.pow, ast.USub: operator.neg,
    ast.UAdd: operator.pos,
}  # fmt: skip


def is_expression(text: str) -> bool:
    """Whether a text computes something: it has a column in braces, or is a number."""
    try:
        float(text)
    except ValueError:
        return "{" in text
    return True


def columns_in(expression: str) -> list[str]:
    """Names of the columns of an expression, each once."""
    return list(dict.fromkeys(name.strip() for name in COLUMN.findall(expression)))


def numbers_in(expression: str) -> list[float]:
    """The numbers that stand in an expression."""
    pattern = r"(?<![\w.])\d+\.?\d*(?:[eE][+-]?\d+)?"
    return [float(number) for number in re.findall(pattern, COLUMN.sub("", expression))]


def evaluated(
    expression: str,
    columns: Mapping[str, np.ndarray],
    constants: Mapping[str, float],
    rows: np.ndarray,
) -> np.ndarray:
    """Values of an expression over columns, names in braces, and constants, names without.

    ``first`` is the value in the first of the rows; InputError for anything but arithmetic.
    """
    names = {name: f"c{number}_" for number, name in enumerate(columns)}
    if len(expression) > LONGEST:
        raise InputError(f"an expression of {len(expression)} letters", remedy="shorten it")
    text = COLUMN.sub(lambda match: names.get(match[1].strip(), "none_"), expression).strip()
    known: dict[str, Any] = {names[name]: values for name, values in columns.items()}
    known |= {name: np.float64(value) for name, value in constants.items()}

    def first(values: Any) -> Any:
        return values[rows[0]] if isinstance(values, np.ndarray) else values

    evaluator = SimpleEval(OPERATORS, {**FUNCTIONS, FIRST: first}, known)
    evaluator.nodes = {
        kind: evaluator.nodes[kind]
        for kind in (ast.Expr, ast.Name, ast.UnaryOp, ast.BinOp, ast.Call)
    } | {ast.Constant: _number}
    try:
        with np.errstate(all="ignore"), warnings.catch_warnings():
            warnings.simplefilter("error")  # several expressions, or an assignment
            value = np.asarray(evaluator.eval(text), dtype=float)
            return np.broadcast_to(value, (next(iter(columns.values())).size,) if columns else ())
    except (InvalidExpression, SyntaxError, TypeError, ValueError, Warning) as error:
        remedy = "it may have numbers, columns in braces, + - * / ** ( ), "
        remedy += f"{', '.join([*FUNCTIONS, FIRST])}, and names of header keys such as edge_x_mm"
        unknown = re.search(r"'(\w+)'(?: is)? not defined", str(error))
        why = "it is not arithmetic"
        if unknown:
            why = f"{unknown[1]!r} is neither a function nor a header key"
        if isinstance(error, SyntaxError):
            why = "a bracket, a brace or an operand is missing"
        if re.search(r"\d,\d", text):
            why, remedy = "numbers have decimal points", f"write {expression.replace(',', '.')!r}"
        if "^" in text:
            why, remedy = "a power is written with **", f"write {expression.replace('^', '**')!r}"
        problem = f"{expression[:80]!r} cannot be computed: {why}"
        raise InputError(problem, remedy=remedy) from None
    except (RecursionError, MemoryError, OverflowError):
        raise InputError(f"{expression[:80]!r} cannot be computed", remedy="shorten it") from None


def _number(node: ast.Constant) -> np.float64:
    """A constant, as a number with the rounding and overflow of the columns."""
    if isinstance(node.value, int | float) and not isinstance(node.value, bool):
        return np.float64(node.value)
    raise ValueError("not a number")
