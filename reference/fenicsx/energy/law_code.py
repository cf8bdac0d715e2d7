"""A law's energy density as code in C: its formula gives a graph, reverse-mode differentiation the derivatives.

The density becomes a graph of scalars in which equal expressions are one node, so the code computes each of them once.
The same graph holds the density's derivatives. `vec` in the code is a vector of numbers, one per point: see
`kernels.c`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from types import SimpleNamespace
from typing import Any

import numpy as np

from ....lhm.base.mesh import Floats

Node = tuple[Any, ...]
"""An operation and the numbers of its operands, or ("number", value), or ("input", its text in C)."""


class Graph:
    """Scalar expressions, each a number that counts nodes; a node's operands have smaller numbers."""

    def __init__(self) -> None:
        self._nodes: list[Node] = []
        self._known: dict[Node, int] = {}

    def node(self, *node: Any) -> int:
        """Return the number of an operation on nodes, which is made if it is new."""
        if node not in self._known:
            self._known[node] = len(self._nodes)
            self._nodes.append(node)
        return self._known[node]

    def number(self, value: float) -> int:
        """Return a constant's node."""
        return self.node("number", float(value))

    def value(self, a: int) -> float | None:
        """Return the value of a node that is a constant."""
        return self._nodes[a][1] if self._nodes[a][0] == "number" else None

    def add(self, a: int, b: int) -> int:
        """Return a + b."""
        x, y = self.value(a), self.value(b)
        if x is not None and y is not None:
            return self.number(x + y)
        if x == 0.0 or y == 0.0:
            return b if x == 0.0 else a
        return self.node("+", *sorted((a, b)))

    def multiply(self, a: int, b: int) -> int:
        """Return a b; a factor of 0 makes it 0, whatever the other is."""
        if self.value(a) is None:
            a, b = b, a
        x, y = self.value(a), self.value(b)
        if x is None:
            return self.node("*", *sorted((a, b)))
        if y is not None:
            return self.number(x * y)
        if x == 0.0 or x == 1.0:
            return a if x == 0.0 else b
        operation, *operands = self._nodes[b]
        scale = self.value(operands[0]) if operation == "*" else None
        return self.node("*", a, b) if scale is None else self.multiply(self.number(x * scale), operands[1])

    def inverse(self, a: int) -> int:
        """Return 1 / a."""
        x = self.value(a)
        return self.node("inverse", a) if not x else self.number(1.0 / x)

    def power(self, a: int, b: int) -> int:
        """Return a to the power of b; whole powers are products."""
        exponent = self.value(b)
        if exponent is None:
            return self.call("exp", self.multiply(b, self.call("log", a)))
        if exponent != round(exponent) or abs(exponent) > 16:
            return self.call("sqrt", a) if exponent == 0.5 else self.node("pow", a, b)
        if exponent < 0:
            return self.inverse(self.power(a, self.number(-exponent)))
        if exponent == 0:
            return self.number(1.0)
        half = self.power(a, self.number(exponent // 2))
        square = self.multiply(half, half)
        return self.multiply(square, a) if exponent % 2 else square

    def call(self, name: str, a: int) -> int:
        """Return a function of one number, by its name in C."""
        return self.node(name, a)

    def select(self, mask: int, a: int, b: int) -> int:
        """Return a where the mask holds, else b."""
        return a if a == b else self.node("select", mask, a, b)

    def gradient(self, of: int, inputs: Sequence[int]) -> list[int]:
        """Return the derivatives of a node by inputs."""
        zero = self.number(0.0)
        by = {of: self.number(1.0)}
        for a in sorted(self._find_needed([of]), reverse=True):
            if a in by:
                for operand, slope in self._slopes(a, inputs):
                    by[operand] = self.add(by.get(operand, zero), self.multiply(by[a], slope))
        return [by.get(a, zero) for a in inputs]

    def _slopes(self, a: int, inputs: Sequence[int]) -> Iterator[tuple[int, int]]:
        """Yield nodes that a node is computed from, and its derivatives by them: all operands, or all inputs.

        A choice is derived by the inputs: what is not chosen may not be a number, and no factor of 0 would end that.
        """
        operation, *operands = self._nodes[a]
        if operation == "+":
            yield from ((operand, self.number(1.0)) for operand in operands)
        elif operation == "*":
            one, other = operands
            yield from ((one, other), (other, one))
        elif operation == "select":
            mask, yes, no = operands
            for slopes in zip(inputs, self.gradient(yes, inputs), self.gradient(no, inputs), strict=True):
                yield slopes[0], self.select(mask, *slopes[1:])
        elif operation in SLOPES:
            yield operands[0], SLOPES[operation](self, a, *operands)

    def _find_needed(self, nodes: Sequence[int]) -> set[int]:
        """Find all nodes that some nodes are computed from, themselves included."""
        needed, open_nodes = set(nodes), list(nodes)
        while open_nodes:
            operation, *operands = self._nodes[open_nodes.pop()]
            if operation not in ("number", "input"):
                open_nodes += set(operands) - needed
                needed |= set(operands)
        return needed

    def write(self, results: Mapping[str, int]) -> str:
        """Write C that computes results by the texts that they are assigned to."""
        lines = []
        for a in sorted(self._find_needed(list(results.values()))):
            operation, *operands = self._nodes[a]
            if operation not in ("number", "input"):
                kind = "mask" if operation == "<" else "vec"
                lines.append(f"const {kind} t{a} = {self._formula(operation, operands)};")
        lines += [f"{text} = {self._vector(a)};" for text, a in results.items()]
        return "\n".join("  " + line for line in lines)

    def _formula(self, operation: str, operands: list[int]) -> str:
        texts = [self._text(operand) for operand in operands]
        if operation in ("+", "*", "<"):
            return f"{texts[0]} {operation} {texts[1]}"
        if operation == "inverse":
            return f"1.0 / {texts[0]}"
        if operation == "select":
            return f"select({texts[0]}, {self._vector(operands[1])}, {self._vector(operands[2])})"
        return f"v{operation}({', '.join(texts)})"

    def _vector(self, a: int) -> str:
        return self._text(a) if self.value(a) is None else f"filled({self._text(a)})"

    def _text(self, a: int) -> str:
        operation, *operands = self._nodes[a]
        return str(operands[0]) if operation == "input" else repr(operands[0]) if operation == "number" else f"t{a}"


SLOPES: dict[str, Callable[..., int]] = {
    "inverse": lambda g, a, x: g.multiply(g.number(-1.0), g.multiply(a, a)),
    "log": lambda g, a, x: g.inverse(x),
    "exp": lambda g, a, x: a,
    "sqrt": lambda g, a, x: g.multiply(g.number(0.5), g.inverse(a)),
    "sin": lambda g, a, x: g.call("cos", x),
    "cos": lambda g, a, x: g.multiply(g.number(-1.0), g.call("sin", x)),
    "tanh": lambda g, a, x: g.add(g.number(1.0), g.multiply(g.number(-1.0), g.multiply(a, a))),
    "atan": lambda g, a, x: g.inverse(g.add(g.number(1.0), g.multiply(x, x))),
    "pow": lambda g, a, x, c: _slope_of_power(g, a, x, c),
}
"""Derivatives of functions, as a node of the graph, from the function's node and its operands."""


def _slope_of_power(graph: Graph, a: int, x: int, c: int) -> int:
    exponent = graph.value(c)
    assert exponent is not None
    if exponent < 1.0:  # what is not finite at 0 may be by a division, which shares the power
        return graph.multiply(c, graph.multiply(a, graph.inverse(x)))
    return graph.multiply(c, graph.power(x, graph.number(exponent - 1.0)))


@dataclass(frozen=True, eq=False)
class Value:
    """A node of a graph with the arithmetic that formulas need; `<` and `>` give masks, for `FUNCTIONS.where`."""

    graph: Graph
    node: int

    def _find(self, other: Value | float) -> int:
        """Find the node of another value, or of a number."""
        return other.node if isinstance(other, Value) else self.graph.number(other)

    def __add__(self, other: Value | float) -> Value:
        return Value(self.graph, self.graph.add(self.node, self._find(other)))

    def __mul__(self, other: Value | float) -> Value:
        return Value(self.graph, self.graph.multiply(self.node, self._find(other)))

    def __neg__(self) -> Value:
        return -1.0 * self

    def __sub__(self, other: Value | float) -> Value:
        return self + -1.0 * other

    def __rsub__(self, other: Value | float) -> Value:
        return other + -self

    def __truediv__(self, other: Value | float) -> Value:
        return Value(self.graph, self.graph.multiply(self.node, self.graph.inverse(self._find(other))))

    def __rtruediv__(self, other: Value | float) -> Value:
        return other * Value(self.graph, self.graph.inverse(self.node))

    def __pow__(self, exponent: Value | float) -> Value:
        return Value(self.graph, self.graph.power(self.node, self._find(exponent)))

    def __lt__(self, other: Value | float) -> Value:
        return Value(self.graph, self.graph.node("<", self.node, self._find(other)))

    def __gt__(self, other: Value | float) -> Value:
        return Value(self.graph, self.graph.node("<", self._find(other), self.node))

    __radd__, __rmul__ = __add__, __mul__


def _call(name: str, x: Value | float) -> Value | float:
    """Call a function of one number by its name in C."""
    return Value(x.graph, x.graph.call(name, x.node)) if isinstance(x, Value) else getattr(math, name)(x)


def _where(mask: Value, a: Value | float, b: Value | float) -> Value:
    """Choose a where the mask holds, else b."""
    return Value(mask.graph, mask.graph.select(mask.node, mask._find(a), mask._find(b)))


IN_C = {"arctan": "atan"} | {name: name for name in ("log", "exp", "sqrt", "sin", "cos", "tanh")}
FUNCTIONS = SimpleNamespace(where=_where, **{name: partial(_call, in_c) for name, in_c in IN_C.items()})
"""The functions that a law's formula may call, by numpy's names."""


class Law:
    """A law psi(s, p) [kPa] of F's signed singular values, its formula in values of a graph.

    `values` are the fields of p: an array (k,) of a number per tet becomes a value, another stays itself. A law that
    `has_pressure` finds a point's pressure [kPa] as p._pressure.
    """

    def __init__(
        self,
        values: Mapping[str, Any],
        density: Callable[[list[Value], Any], Value] | None = None,
        *,
        has_pressure: bool = False,
    ):
        self.has_pressure = has_pressure
        self._values, self._density = values, density

    @property
    def parameters(self) -> Floats:
        """The code's array `parameters`, shape (k, N)."""
        return np.column_stack([value for value in self._values.values() if isinstance(value, np.ndarray)])

    @cached_property
    def code(self) -> str:
        """The body of `law_stretches` of `kernels.c`: psi, its gradient and its Hessian."""
        graph = Graph()
        names = [name for name, value in self._values.items() if isinstance(value, np.ndarray)]
        texts = {name: f"parameters[{n}]" for n, name in enumerate(names)}
        if self.has_pressure:
            texts["_pressure"] = "parameters[PARAMETERS]"
        inputs = {name: Value(graph, graph.node("input", text)) for name, text in texts.items()}
        s = [Value(graph, graph.node("input", f"s[{i}]")) for i in range(3)]
        assert self._density is not None
        psi = self._density(s, SimpleNamespace(**(dict(self._values) | inputs))).node
        by = [value.node for value in s]
        gradient = graph.gradient(psi, by)
        results = {"psi": psi} | {f"p[{i}]": node for i, node in enumerate(gradient)}
        for i, entry in enumerate(gradient):
            hessian = graph.gradient(entry, by)
            results |= {f"h[{3 * i + j}] = h[{3 * j + i}]": hessian[j] for j in range(i, 3)}
        return graph.write(results)
