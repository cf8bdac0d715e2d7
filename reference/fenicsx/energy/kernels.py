"""Integrals of laws over tets and prisms by compiled loops; each kind of law and element is a library.

It is made from `kernels.c` and compiled where it is first asked for, by the compiler that DOLFINx' own forms need, and
kept in the user's cache. Its name holds its source and the processor, so a cache may be shared; processes that ask at
once wait for the first of them.
"""

from __future__ import annotations

import ctypes
import fcntl
import functools
import hashlib
import os
import platform
import shlex
import subprocess
import sysconfig
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ....lhm.base.errors import MissingDependencyError
from ....lhm.base.files.cache import cache_folder
from ....lhm.base.mesh import Floats, Ints
from ...clock import count_compilation
from .. import dolfinx_version as seam
from ..mesh.numbering import Numbering
from .assembly import Stiffness
from .law_code import Law
from .prisms import Prisms

SOURCE = Path(__file__).with_name("kernels.c")
# Without -ffast-math: an energy that is not a number must stay one.
FLAGS = ("-std=gnu11", "-O3", "-fno-math-errno", "-fno-trapping-math", "-shared", "-fPIC")
NATIVE = "-march=native"  # which not every compiler knows on every processor
ARGUMENTS = "const vec *s, const vec *parameters, vec *p, vec *h"
SUMS = {f"by[{i}]": f"p[{i}]" for i in range(3)} | {f"twice[{i}]": f"h[{i}]" for i in range(9)}


class Tets(ctypes.Structure):
    """`struct tets` of kernels.c."""

    _fields_ = (
        ("blocks", ctypes.c_int64),
        ("nodes", ctypes.c_void_p),
        ("geometry", ctypes.c_void_p),
        ("volume", ctypes.c_void_p),
        ("parameters", ctypes.c_void_p),
    )


@dataclass(frozen=True, eq=False)
class Elements:
    """Elements that a kernel integrates over: nodes (k, a), volumes (k,) [mm³], and geometry (k, g) as of kernels.c.

    A rule of q points: weights (q,) that add up to 1, derivatives of the shape functions on the reference tet
    (q, a, 3), None of prisms, and the corners' linear shape functions (q, 4).
    """

    nodes: Ints
    volumes: Floats
    geometry: Floats
    weights: Floats
    shapes: Floats | None = None
    corner_shapes: Floats | None = None

    @classmethod
    def from_tets(cls, numbering: Numbering, cells: Ints, degree: int) -> Elements:
        """Tets (k,), as the numbering counts them, with the rule of a degree."""
        points, weights = seam.quadrature_rule(degree)
        corners = numbering.X[numbering.dof[numbering.cell_vertices[cells]]]
        inverse = np.linalg.inv((corners[:, 1:] - corners[:, :1]).transpose(0, 2, 1)).reshape(-1, 9)
        volumes, shapes = numbering.cell_volumes[cells], seam.shapes(numbering.degree, points)[1]
        corner_shapes = seam.shapes(1, points)[0]
        return cls(numbering.cell_dofs[cells], volumes, inverse, weights / weights.sum(), shapes, corner_shapes)

    @classmethod
    def from_prisms(cls, prisms: Prisms, rows: Ints) -> Elements:
        """Some prisms (k,), with one point each."""
        gradients = prisms.mean[rows].reshape(-1, 18)
        return cls(prisms.nodes[rows], prisms.volumes[rows].sum(axis=1), gradients, np.ones(1))


class Kernel:
    """The integral over some elements (k,) of the sum of laws, with energy [µJ], gradient [mN] and Hessian [mN/mm].

    A law that has a pressure is alone. It takes the pressure from linear elements, whose nodes at the corners of the
    tets are `pressure_dofs` (k, 4).
    """

    def __init__(self, elements: Elements, laws: Sequence[Law], pressure_dofs: Ints | None = None):
        self._count, self._per_cell = len(elements.nodes), len(elements.weights)
        with count_compilation():
            self._library = load_library(_header(elements, laws))
        self._width = ctypes.c_int64.in_dll(self._library, "width").value
        self._rows = np.minimum(np.arange(-(-self._count // self._width) * self._width), self._count - 1)
        self._volume = np.where(np.arange(len(self._rows)) < self._count, elements.volumes[self._rows], 0.0)
        self._nodes = np.ascontiguousarray(elements.nodes[self._rows], dtype=np.int64)
        self._geometry = self._by_block(elements.geometry[self._rows])
        self._slots: Ints | None = None
        self._pressure_dofs: Ints | None = None
        if laws[0].has_pressure:
            assert pressure_dofs is not None
            self._pressure_dofs = self._by_block(pressure_dofs[self._rows])
        self.set(laws)

    def _by_block(self, rows: np.ndarray) -> np.ndarray:
        """Rows (tets, N) in the order of kernels.c, (blocks, N, width)."""
        blocks = rows.reshape(len(rows) // self._width, self._width, rows.shape[1])
        return np.ascontiguousarray(blocks.transpose(0, 2, 1))

    def set(self, laws: Sequence[Law]):
        """Take the parameters of laws of the same kinds."""
        parameters = np.concatenate([law.parameters for law in laws], axis=1)
        if self._pressure_dofs is not None:
            parameters = np.column_stack([parameters, np.zeros((len(parameters), 4))])
        self._parameters = self._by_block(parameters[self._rows])
        arrays = (self._nodes, self._geometry, self._volume, self._parameters)
        self._tets = Tets(len(self._rows) // self._width, *(_address(array) for array in arrays))

    def take_pressure(self, p: Floats):
        """Take the pressure [kPa] of linear elements by node, shape (n_p,), if the law has one."""
        if self._pressure_dofs is not None:
            self._parameters[:, -4:] = p[self._pressure_dofs]

    def add_energy(self, u: Floats, gradient: Floats) -> float:
        """Return the energy of a displacement [mm], (n, 3), and add its gradient; not finite where a law is not."""
        return self._library.energy(ctypes.byref(self._tets), _address(u), _address(gradient))

    def stress(self, u: Floats) -> Floats:
        """Return P [kPa] at the points, shape (k q, 3, 3)."""
        P = np.empty((len(self._rows), self._per_cell, 3, 3))
        self._library.stress(ctypes.byref(self._tets), _address(u), _address(P))
        return P[: self._count].reshape(-1, 3, 3)

    def add_hessian(self, u: Floats, kept: float, into: Stiffness):
        """Add the Hessian, every negative eigenvalue of every point's dP/dF multiplied by `kept`."""
        if self._slots is None:
            self._slots = into.slots(self._nodes)
        arrays = (into.starts, self._slots, into.values)
        addresses = (_address(array) for array in arrays)
        self._library.hessian(ctypes.byref(self._tets), _address(u), ctypes.c_double(kept), *addresses)
        into.touch()


def _address(array: np.ndarray) -> ctypes.c_void_p:
    assert array.flags.c_contiguous
    return ctypes.c_void_p(array.ctypes.data)


def _header(elements: Elements, laws: Sequence[Law]) -> str:
    """Write law.h for kernels.c: the elements' shapes and rule, and the laws."""

    def braces(array: np.ndarray) -> str:
        return repr(float(array)) if array.ndim == 0 else "{" + ", ".join(braces(part) for part in array) + "}"

    lines = [
        f"#define NODES {elements.nodes.shape[1]}",
        f"#define POINTS {len(elements.weights)}",
        f"#define PARAMETERS {sum(law.parameters.shape[1] + 4 * law.has_pressure for law in laws)}",
        f"static const double WEIGHTS[POINTS] = {braces(elements.weights)};",
    ]
    if elements.shapes is None:
        lines.append("#define PRISMS")
    else:
        lines.append(f"static const double SHAPES[POINTS][NODES][3] = {braces(elements.shapes)};")
    if laws[0].has_pressure:
        assert elements.corner_shapes is not None
        lines += ["#define HAS_PRESSURE", f"static const double CORNERS[POINTS][4] = {braces(elements.corner_shapes)};"]
    lines += [_function(f"part{n}", law.code) for n, law in enumerate(laws)]
    return "\n".join([*lines, _function("law_stretches", _sum_parts(laws))]) + "\n"


def _function(name: str, body: str) -> str:
    return f"static inline vec {name}({ARGUMENTS}) {{\n  vec psi;\n{body}\n  return psi;\n}}"


def _sum_parts(laws: Sequence[Law]) -> str:
    """Write the sum of part0, part1 and so on, whose parameters follow one another."""
    lines, begin = ["  vec by[3], twice[9];", "  psi = part0(s, parameters, p, h);"], laws[0].parameters.shape[1]
    for n, law in enumerate(laws[1:], 1):
        lines.append(f"  psi += part{n}(s, parameters + {begin}, by, twice);")
        lines += [f"  {total} += {text};" for text, total in SUMS.items()]
        begin += law.parameters.shape[1]
    return "\n".join(lines)


@functools.cache
def load_library(header: str) -> ctypes.CDLL:
    """Return the library of kernels.c with a law.h, compiled if no process of this user did so before."""
    text = SOURCE.read_text()
    key = hashlib.sha256("\0".join((text, header, *FLAGS, _name_processor())).encode()).hexdigest()[:32]
    folder = cache_folder() / "kernels"
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{key}.so"
    with path.with_suffix(".lock").open("a") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not path.exists():
            _compile(header, path)
    library = ctypes.CDLL(str(path))
    library.energy.restype = ctypes.c_double
    return library


def _name_processor() -> str:
    """Name the kind of processor, and on Linux its instructions, which code for it may use."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return f"{platform.machine()} {platform.processor()}"
    return platform.machine() + next((line for line in lines if line.lower().startswith(("flags", "features"))), "")


def _compile(header: str, path: Path):
    """Compile kernels.c with a law.h to a file that is whole as soon as it is there."""
    compiler = shlex.split(os.environ.get("CC") or sysconfig.get_config_var("CC") or "cc")
    with tempfile.TemporaryDirectory(dir=path.parent) as folder:
        made = Path(folder, path.name)
        Path(folder, "law.h").write_text(header)
        for flags in ((*FLAGS, NATIVE), FLAGS):
            command = [*compiler, *flags, f"-I{folder}", str(SOURCE), "-o", str(made), "-lm"]
            try:
                result = subprocess.run(command, capture_output=True, text=True, check=False)
            except OSError as error:
                raise MissingDependencyError(f"solver 'fenicsx' needs a C compiler ({error})") from None
            if result.returncode == 0:
                made.replace(path)
                return
    errors = [line for line in result.stderr.splitlines() if "error" in line] or [f"status {result.returncode}"]
    raise MissingDependencyError(f"solver 'fenicsx': the C compiler failed ({shlex.join(compiler)}): {errors[0]}")
