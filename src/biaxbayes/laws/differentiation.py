"""Derivatives of a strain energy, exact, as code that numba compiles.

The energy of a law is called once with expressions in place of numbers, on which each operation of
NumPy makes another, so that W is known as a graph. Reverse accumulation gives its derivatives as
graphs, too, and a graph is written as a Python function with one operation a line. Comparisons are
of real parts, so that second derivatives are complex steps of the first.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin

from biaxbayes.errors import InputError


class Expression(NDArrayOperatorsMixin):
    """An operation on numbers and other expressions, or a variable (``varies``) or constant."""

    def __init__(self, operation: Any, *operands: Any, varies: bool = False) -> None:
        self.operation = operation  # a name, where there are no operands
        self.operands = operands
        self.varies = varies or any(getattr(o, "varies", False) for o in operands)

    def __array_ufunc__(self, ufunc: Any, method: str, *operands: Any, **others: Any) -> Any:
        """NumPy's operation on expressions."""
        if ufunc in COMPOSED:
            return COMPOSED[ufunc](*operands)
        if ufunc not in OPERATIONS or method != "__call__" or others:
            given = f"np.{ufunc.__name__}" + (f" with {', '.join(others)}" if others else "")
            raise InputError(f"an energy cannot use {given}")
        return Expression(ufunc, *operands)

    def __bool__(self) -> bool:
        raise InputError(
            "an energy cannot branch", remedy="write max(E, 0) as np.maximum(E, 0.0), for example"
        )


class Operation(NamedTuple):
    """Code of an operation, and its derivatives by its operands, given its value and these."""

    code: str
    slopes: Callable[..., tuple[Any, ...]] = lambda *_: ()


def exponential(k: Any, x: Any) -> Any:
    """(exp(k x) - 1) / k, which is x where k is zero."""
    if isinstance(k, Expression) or isinstance(x, Expression):
        return Expression(exponential, k, x)
    k = np.asarray(k)
    safe = np.where(k == 0.0, 1.0, k)
    return np.where(k == 0.0, x, np.expm1(k * x) / safe)


def _power(base: Any, exponent: Any) -> Any:
    """Products for whole exponents, which hold for negative bases, else by the logarithm."""
    if isinstance(exponent, int | float) and exponent == int(exponent) and 0 < exponent <= 16:
        product = base
        for _ in range(int(exponent) - 1):
            product = product * base
        return product
    if isinstance(exponent, int | float) and -16 <= exponent < 0:
        return 1.0 / _power(base, -exponent)
    return np.exp(exponent * np.log(base))


def _maximum(a: Any, b: Any) -> Any:
    """The larger one, by real parts."""
    if isinstance(b, int | float) and b == 0:
        return a * np.greater(a, 0.0)
    return b + (a - b) * np.greater(a, b)


COMPOSED: dict[Any, Callable[..., Any]] = {
    np.power: _power,
    np.square: lambda a: a * a,
    np.maximum: _maximum,
}
OPERATIONS: dict[Any, Operation] = {
    np.add: Operation("{} + {}", lambda v, a, b: (1.0, 1.0)),
    np.subtract: Operation("{} - {}", lambda v, a, b: (1.0, -1.0)),
    np.multiply: Operation("{} * {}", lambda v, a, b: (b, a)),
    np.divide: Operation("{} / {}", lambda v, a, b: (1.0 / b, -v / b)),
    np.negative: Operation("-{}", lambda v, a: (-1.0,)),
    np.exp: Operation("np.exp({})", lambda v, a: (v,)),
    np.expm1: Operation("np.expm1({})", lambda v, a: (np.exp(a),)),
    np.log: Operation("np.log({})", lambda v, a: (1.0 / a,)),
    np.sqrt: Operation("np.sqrt({})", lambda v, a: (0.5 / v,)),
    np.less: Operation("({}).real < ({}).real"),
    np.greater: Operation("({}).real > ({}).real"),
    # stretches enter x, never k
    exponential: Operation("exponential({}, {})", lambda v, k, x: (0.0, np.exp(k * x))),
}


def in_order(outputs: Sequence[Any]) -> list[Expression]:
    """Some expressions and all that they are made of, operands first."""
    ordered: dict[int, Expression] = {}

    def visit(e: Any) -> None:
        if isinstance(e, Expression) and id(e) not in ordered:
            for operand in e.operands:
                visit(operand)
            ordered[id(e)] = e

    for e in outputs:
        visit(e)
    return list(ordered.values())


def gradient(value: Expression, variables: Sequence[Expression]) -> list[Any]:
    """Derivatives of an expression by some of its variables."""
    slope: dict[int, Any] = {id(value): 1.0}  # d value / d expression
    for e in reversed(in_order([value])):
        if not e.operands or id(e) not in slope:
            continue
        slopes = OPERATIONS[e.operation].slopes(e, *e.operands)
        for operand, by in zip(e.operands, slopes, strict=False):
            if getattr(operand, "varies", False):
                # d value / d operand = sum over its uses of d value / d e * d e / d operand
                part = _product(slope[id(e)], by)
                slope[id(operand)] = slope[id(operand)] + part if id(operand) in slope else part
    return [slope.get(id(v), 0.0) for v in variables]


def exponents_of(value: Expression) -> list[Expression]:
    """The exponents of the exponentials that an expression is made of, in their order."""
    return [
        e.operands[0] * e.operands[1] if e.operation is exponential else e.operands[0]
        for e in in_order([value])
        if e.operation in (np.exp, np.expm1, exponential) and e.varies
    ]


def _product(a: Any, b: Any) -> Any:
    """Product without factors of one."""
    if isinstance(a, float) and a == 1.0:
        return b
    return a if isinstance(b, float) and b == 1.0 else a * b


def source(name: str, arguments: str, unpacked: str, outputs: Sequence[Any]) -> str:
    """A Python function that returns some expressions as a tuple, as text."""
    names: dict[int, str] = {}
    lines: list[str] = []

    def named(operand: Any) -> str:
        return names[id(operand)] if isinstance(operand, Expression) else repr(float(operand))

    for e in in_order(outputs):
        names[id(e)] = f"_{len(lines)}" if e.operands else e.operation
        if e.operands:
            code = OPERATIONS[e.operation].code.format(*map(named, e.operands))
            lines.append(f"{names[id(e)]} = {code}")
    results = "".join(f"{named(e)}, " for e in outputs)
    body = [f"def {name}({arguments}):", unpacked, *lines, f"return ({results})"]
    return "\n    ".join(body) + "\n"
