"""A law's energy density as code in C: UFL gives the density, reverse-mode differentiation its derivatives.

The density becomes a graph of scalars in which equal expressions are one node, so the code computes each of them once.
The same graph holds the density's derivatives. `vec` in the code is a vector of numbers, one per point: see
`kernels.c`.
"""

from __future__ import annotations

from collections.abc import Callable, Container, Iterator, Mapping, Sequence
from functools import cached_property
from types import SimpleNamespace
from typing import Any

import numpy as np
import ufl
from ufl.algorithms import expand_derivatives, expand_indices
from ufl.algorithms.apply_algebra_lowering import apply_algebra_lowering
from ufl.corealg.map_dag import map_expr_dag
from ufl.corealg.multifunction import MultiFunction

from ....lhm.base.mesh import Floats

Node = tuple[Any, ...]
"""An operation and the numbers of its operands, or ("number", value), or ("input", its text in C)."""


class UnknownOperationError(Exception):
    """An operation of UFL that this module does not translate."""


def input_symbol() -> Any:
    """Return a scalar of UFL that stands for an input of the code; no two are the same."""
    return ufl.variable(ufl.as_ufl(0.5))


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
                kind = "mask" if operation in MASKS else "vec"
                lines.append(f"const {kind} t{a} = {self._formula(operation, operands)};")
        lines += [f"{text} = {self._vector(a)};" for text, a in results.items()]
        return "\n".join("  " + line for line in lines)

    def _formula(self, operation: str, operands: list[int]) -> str:
        texts = [self._text(operand) for operand in operands]
        if operation in ("+", "*", "<", "<=", "==", "&", "|"):
            return f"{texts[0]} {operation} {texts[1]}"
        if operation == "inverse":
            return f"1.0 / {texts[0]}"
        if operation == "not":
            return f"~{texts[0]}"
        if operation == "select":
            return f"select({texts[0]}, {self._vector(operands[1])}, {self._vector(operands[2])})"
        return f"v{operation}({', '.join(texts)})"

    def _vector(self, a: int) -> str:
        return self._text(a) if self.value(a) is None else f"filled({self._text(a)})"

    def _text(self, a: int) -> str:
        operation, *operands = self._nodes[a]
        return str(operands[0]) if operation == "input" else repr(operands[0]) if operation == "number" else f"t{a}"


MASKS = ("<", "<=", "==", "&", "|", "not")
"""Operations whose result is true or false at each point."""

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


FUNCTIONS = {"Ln": "log", "Exp": "exp", "Sqrt": "sqrt", "Sin": "sin", "Cos": "cos", "Tanh": "tanh", "Atan": "atan"}
COMPARISONS = {"LT": "<", "LE": "<=", "GT": "<", "GE": "<=", "EQ": "==", "NE": "=="}


class WithoutVariables(MultiFunction):
    """Replaces each variable but some by its expression: UFL's `expand_indices` takes one entry of it for all."""

    def __init__(self, kept: Container[Any]):
        super().__init__()
        self._kept = kept

    expr = MultiFunction.reuse_if_untouched

    def variable(self, variable: Any) -> Any:
        """Keep a variable, or go on in its expression."""
        return variable if variable in self._kept else map_expr_dag(self, variable.ufl_operands[0])


class Translation:
    """Expressions of UFL as nodes of a graph, in which inputs stand for some of UFL's symbols."""

    def __init__(self, symbols: Mapping[Any, str]):
        self.graph = Graph()
        self._known = {symbol: self.graph.node("input", text) for symbol, text in symbols.items()}

    def derivatives(self, expression: Any, by: Sequence[Any]) -> tuple[int, list[int], list[list[int]]]:
        """Return the nodes of a scalar expression, of its gradient and of its Hessian by symbols."""
        psi, inputs = self.translate(expression), [self._known[symbol] for symbol in by]
        gradient = self.graph.gradient(psi, inputs)
        return psi, gradient, [self.graph.gradient(entry, inputs) for entry in gradient]

    def translate(self, expression: Any) -> int:
        """Return the node of a scalar expression; UnknownOperationError for what UFL's cannot be translated."""
        derived = expand_derivatives(apply_algebra_lowering(ufl.as_ufl(expression)))
        return self._scalar(expand_indices(map_expr_dag(WithoutVariables(self._known), derived)))

    def _scalar(self, e: Any) -> int:
        if e not in self._known:
            self._known[e] = self._translate(e)
        return self._known[e]

    def _translate(self, e: Any) -> int:
        graph, kind = self.graph, type(e).__name__
        if kind in ("Zero", "IntValue", "FloatValue", "RealValue", "ScalarValue"):
            return graph.number(float(e))
        operands = [self._scalar(operand) for operand in e.ufl_operands if type(operand).__name__ != "Label"]
        if kind in FUNCTIONS:
            return graph.call(FUNCTIONS[kind], operands[0])
        if kind in COMPARISONS:
            mask = graph.node(COMPARISONS[kind], *(operands[::-1] if kind in ("GT", "GE") else operands))
            return graph.node("not", mask) if kind == "NE" else mask
        operations: dict[str, Callable[..., int]] = {
            "Variable": lambda a: a,
            "Conj": lambda a: a,
            "Real": lambda a: a,
            "Sum": graph.add,
            "Product": graph.multiply,
            "Division": lambda a, b: graph.multiply(a, graph.inverse(b)),
            "Power": graph.power,
            "Conditional": graph.select,
            "AndCondition": lambda a, b: graph.node("&", a, b),
            "OrCondition": lambda a, b: graph.node("|", a, b),
            "NotCondition": lambda a: graph.node("not", a),
            "MaxValue": lambda a, b: graph.select(graph.node("<", a, b), b, a),
            "MinValue": lambda a, b: graph.select(graph.node("<", a, b), a, b),
            "Abs": lambda a: graph.select(
                graph.node("<", a, graph.number(0.0)), graph.multiply(graph.number(-1.0), a), a
            ),
        }
        if kind not in operations or e.ufl_shape != ():
            raise UnknownOperationError(kind)
        return operations[kind](*operands)


class Law:
    """A law in UFL [kPa]: psi(F, p), or psi(s, p) of F's signed singular values, or both of an isotropic one.

    `values` are the fields of p: arrays (k,) and (k, 3) of a number and a vector per tet become UFL's scalars and
    vectors, what is no array stays itself. A law that `has_pressure` finds a point's pressure [kPa] as p._pressure.
    """

    def __init__(
        self,
        values: Mapping[str, Any],
        *,
        density: Callable[[Any, Any], Any] | None = None,
        by_stretches: Callable[[Any, Any], Any] | None = None,
        has_pressure: bool = False,
    ):
        self.has_pressure = has_pressure
        self._values, self._density, self._by_stretches = values, density, by_stretches
        self.is_by_stretches = density is None

    @property
    def parameters(self) -> Floats:
        """What the code calls `parameters`, shape (k, N)."""
        return np.column_stack([value for value in self._values.values() if isinstance(value, np.ndarray)])

    @cached_property
    def functions(self) -> dict[str, str]:
        """The bodies of `law_stress`, `law_tangent` and `law_stretches` of `kernels.c`, those that there can be.

        Raises UnknownOperationError for a density that cannot be written.
        """
        names, p = self._symbols()
        functions = {}
        if self._density is not None:
            F = [input_symbol() for _ in range(9)]
            code = Translation({symbol: f"F[{i}]" for i, symbol in enumerate(F)} | names)
            psi, P, tangent = code.derivatives(self._density(ufl.as_matrix([F[:3], F[3:6], F[6:]]), p), F)
            functions["law_stress"] = code.graph.write({"psi": psi} | {f"P[{i}]": node for i, node in enumerate(P)})
            functions["law_tangent"] = code.graph.write(
                {f"A[{i}][{j}] = A[{j}][{i}]": tangent[i][j] for i in range(9) for j in range(i, 9)}
            )
        if self._by_stretches is not None:
            s = [input_symbol() for _ in range(3)]
            code = Translation({symbol: f"s[{i}]" for i, symbol in enumerate(s)} | names)
            psi, gradient, hessian = code.derivatives(self._by_stretches(s, p), s)
            results = {"psi": psi} | {f"p[{i}]": node for i, node in enumerate(gradient)}
            results |= {f"h[{3 * i + j}] = h[{3 * j + i}]": hessian[i][j] for i in range(3) for j in range(i, 3)}
            functions["law_stretches"] = code.graph.write(results)
        return functions

    def _symbols(self) -> tuple[dict[Any, str], SimpleNamespace]:
        """The fields of p as UFL's symbols, and each symbol's text in C."""
        names: dict[Any, str] = {}
        p = SimpleNamespace(**self._values)
        for key, value in self._values.items():
            if isinstance(value, np.ndarray):
                symbols = [input_symbol() for _ in range(int(np.prod(value.shape[1:])))]
                setattr(p, key, symbols[0] if value.ndim == 1 else ufl.as_vector(symbols))
                names |= {symbol: f"parameters[{len(names) + n}]" for n, symbol in enumerate(symbols)}
        if self.has_pressure:
            p._pressure = input_symbol()
            names[p._pressure] = "parameters[PARAMETERS]"
        return names, p
