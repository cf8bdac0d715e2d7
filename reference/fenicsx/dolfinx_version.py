"""The seam: the only module that knows which dolfinx is installed (0.5 as in Debian 12, to 0.11).

What differs: names of spaces and of quadrature elements, arguments of `create_mesh`, options of `form`, and the type
of dofmaps. A mesh lives on all ranks of its communicator, and all of them make the same calls. `ALL` are those that
PETSc was begun with: all that mpirun has started, unless a program says `petsc4py.init(comm=MPI.COMM_SELF)` first
because its ranks solve each on their own.
"""

from __future__ import annotations

import fcntl
import logging
import os
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from ...lhm.base.errors import MissingDependencyError, SceneError
from ...lhm.base.files import cache
from ...lhm.base.mesh import Floats, Ints
from ..clock import count_compilation

for _name in ("FFC", "ffcx", "UFL", "UFL_LEGACY"):
    logging.getLogger(_name).setLevel(logging.ERROR)

INSTALL = "Debian: apt-get install python3-dolfinx; conda: environment.yml"

# Open MPI's daemon, which a process alone would start, is for spawning ranks; it outlives the process and prints late.
os.environ.setdefault("OMPI_MCA_ess_singleton_isolated", "1")

try:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # ufl 2022 warns of pkg_resources
        import basix
        import dolfinx
        import ufl
        from dolfinx import fem, mesh
        from dolfinx.fem import petsc
        from mpi4py import MPI
        from petsc4py import PETSc
except ImportError as error:
    raise MissingDependencyError(f"solver 'fenicsx' needs dolfinx ({error}); {INSTALL}") from None
except OSError as error:  # of pkg_resources, which ufl asks
    reason = f"dolfinx cannot be imported ({error}); is there a working folder?"
    raise MissingDependencyError(f"solver 'fenicsx': {reason}") from None


def parse_version(text: str) -> tuple[int, int]:
    """Major and minor of dolfinx's version; MissingDependencyError outside the range this module was written for."""
    major, minor = (int(part) for part in text.split(".")[:2])
    if not (0, 5) <= (major, minor) <= (0, 11):
        raise MissingDependencyError(f"dolfinx {text} is installed; softdeca knows 0.5 to 0.11 ({INSTALL})")
    return major, minor


VERSION = parse_version(dolfinx.__version__)
ALONE, ALL = MPI.COMM_SELF, PETSc.COMM_WORLD.tompi4py()
_fem: Any = fem  # names and signatures differ by version

# Without -ffast-math: an energy that is not a number must stay one. Compiled forms are cached on disk by dolfinx.
_COMPILER = {"jit_params" if VERSION < (0, 6) else "jit_options": {"cffi_extra_compile_args": ["-O2"]}}
_DEFAULTS = getattr(dolfinx.jit, f"DOLFINX_DEFAULT_JIT_{'PARAMETERS' if VERSION < (0, 6) else 'OPTIONS'}")
if not cache.is_writable(Path(_DEFAULTS["cache_dir"][0])):
    _DEFAULTS["cache_dir"] = (cache.cache_folder() / "fenics", _DEFAULTS["cache_dir"][1])


@contextmanager
def _serialise_compilation(comm) -> Iterator[None]:
    """One program at a time, and without the compiler's progress, which it logs under the root's name.

    Of several that ask for the same form at once one compiles it, the others find it in the cache: dolfinx itself would
    give up waiting after 10 s. Within a communicator the first rank compiles, and dolfinx lets the others wait. What
    killed processes left half compiled goes first: dolfinx would wait for its end, and give up.
    """
    before = logging.root.manager.disable
    logging.disable(max(before, logging.INFO))
    try:
        folder = Path(_DEFAULTS["cache_dir"][0])
        folder.mkdir(parents=True, exist_ok=True)
        with count_compilation(), (folder / "softdeca.lock").open("a") as lock:
            if comm.rank == 0:
                fcntl.flock(lock, fcntl.LOCK_EX)
                for source in folder.glob("libffcx_*.c"):
                    if not source.with_suffix(".c.cached").exists():
                        source.unlink(missing_ok=True)
            yield
    except OSError as error:  # the cache, or ffcx's settings in the home folder
        raise SceneError(f"solver 'fenicsx': forms cannot be compiled ({error})") from None
    finally:
        logging.disable(before)


def tet_mesh(vertices: Floats, tets: Ints, comm) -> mesh.Mesh:
    """A dolfinx mesh of affine tets; vertices in no tet are dropped, and both are renumbered.

    Every rank gives the whole and keeps the part that the graph partitioner makes its own. No form integrates over
    inner faces, so there are no cells of others at its border.
    """
    if VERSION < (0, 6):
        coordinates = ufl.VectorElement("Lagrange", ufl.tetrahedron, 1)
    else:
        import basix.ufl

        coordinates = basix.ufl.element("Lagrange", "tetrahedron", 1, shape=(3,))
    cells, points = (np.ascontiguousarray(_slice(rows, comm)) for rows in (tets, vertices))
    shared: dict[str, Any] = {}
    if VERSION < (0, 6):
        shared["ghost_mode"] = mesh.GhostMode.none
    elif comm.size > 1 and VERSION < (0, 11):  # from then on by itself
        shared["partitioner"] = mesh.create_cell_partitioner(mesh.GhostMode.none)
    given = (points, ufl.Mesh(coordinates)) if VERSION < (0, 10) else (ufl.Mesh(coordinates), points)
    return mesh.create_mesh(comm, cells, *given, **shared)


def _slice(rows: np.ndarray, comm) -> np.ndarray:
    """A rank's run of rows, in the order of ranks."""
    cut = [len(rows) * rank // comm.size for rank in (comm.rank, comm.rank + 1)]
    return rows[cut[0] : cut[1]]


def boundary(domain) -> tuple[Ints, Ints, Ints]:
    """The facets (k,) of the boundary that this rank has, each one's cell, and which of its facets it is."""
    topology = domain.topology
    topology.create_connectivity(2, 3)
    topology.create_connectivity(3, 2)
    facets = np.asarray(mesh.exterior_facet_indices(topology)).astype(np.int64)
    beside = topology.connectivity(2, 3)
    cells = np.asarray(beside.array)[np.asarray(beside.offsets)[facets]].astype(np.int64)
    local = np.argmax(_table(topology.connectivity(3, 2), 4)[cells] == facets[:, None], axis=1)
    return facets, cells, local


def communicator(domain) -> MPI.Intracomm:
    """The ranks that share a mesh, of dolfinx or as forms know it."""
    return domain.comm if hasattr(domain, "comm") else domain.ufl_cargo().comm


def _table(dofmap, columns: int) -> Ints:
    """A dofmap as an integer array, shape (cells, columns)."""
    raw = dofmap.array if hasattr(dofmap, "array") else dofmap
    return np.asarray(raw).reshape(-1, columns).astype(np.int64)


def cell_dofs(space, columns: int) -> Ints:
    """Block dofs per cell, shape (cells, columns)."""
    return _table(space.dofmap.list, columns)


def dof_counts(space) -> tuple[int, int]:
    """The numbers of a space's block dofs that this rank owns, and of those that it shares with their owners."""
    return space.dofmap.index_map.size_local, space.dofmap.index_map.num_ghosts


def global_dofs(space) -> Ints:
    """The numbers over all ranks of a rank's block dofs, first its own."""
    numbering = space.dofmap.index_map
    return np.concatenate([np.arange(*numbering.local_range), np.asarray(numbering.ghosts)]).astype(np.int64)


def cell_vertices(domain) -> Ints:
    """The scene's vertices of each cell, in the order of its local dofs, shape (cells, 4)."""
    geometry = domain.geometry
    dofmap = geometry.dofmap if VERSION < (0, 11) else geometry.dofmaps[0]
    return np.asarray(geometry.input_global_indices)[_table(dofmap, 4)].astype(np.int64)


def cell_tets(domain) -> Ints:
    """The scene's tet of each cell of this rank, shape (cells,)."""
    return np.asarray(domain.topology.original_cell_index, dtype=np.int64)


def _space(domain, family: str, degree: int, *, vectors: bool):
    with _serialise_compilation(communicator(domain)):
        if VERSION < (0, 6):
            make = _fem.VectorFunctionSpace if vectors else _fem.FunctionSpace
            return make(domain, (family, degree))
        return _fem.functionspace(domain, (family, degree, (3,)) if vectors else (family, degree))


def vector_space(domain, degree: int):
    """Continuous vectors, piecewise of a degree."""
    return _space(domain, "Lagrange", degree, vectors=True)


def pressure_space(domain):
    """Continuous piecewise linear numbers."""
    return _space(domain, "Lagrange", 1, vectors=False)


def cell_numbers(domain, cells: Ints, values: Floats | float):
    """A function that is one number per cell: one or (k,) values on cells (k,), zero elsewhere."""
    result = function(_space(domain, "DG", 0, vectors=False))
    result.x.array[cell_dofs(result.function_space, 1)[cells, 0]] = values
    return result


def quadrature_rule(degree: int, cell: str = "tetrahedron") -> tuple[Floats, Floats]:
    """Points (q, d) and weights (q,) of the rule on a reference cell, as the form compiler takes them."""
    points, weights = basix.make_quadrature(getattr(basix.CellType, cell), degree)
    return points, weights


def shapes(degree: int, points: Floats, cell: str = "tetrahedron") -> tuple[Floats, Floats]:
    """Lagrange's shape functions on a reference cell at points (q, d): values (q, k) and derivatives (q, k, d)."""
    family, variant = basix.ElementFamily.P, basix.LagrangeVariant.gll_warped
    table = basix.create_element(family, getattr(basix.CellType, cell), degree, variant).tabulate(1, points)
    return table[0, :, :, 0], np.moveaxis(table[1:, :, :, 0], 0, -1)


def compile_form(form: ufl.Form):
    """Compile a form, or take it from dolfinx's cache on disk."""
    with _serialise_compilation(communicator(form.ufl_domain())):
        return _fem.form(form, **_COMPILER)


def cell_measure(domain, cells: Ints) -> ufl.Measure:
    """The volume measure of some cells."""
    entities = np.sort(cells).astype(np.int32)
    tags = mesh.meshtags(domain, domain.topology.dim, entities, np.ones(len(entities), dtype=np.int32))
    return ufl.Measure("dx", domain=domain, subdomain_data=tags)(1)


def constant(domain, value: float):
    """A number that a compiled form takes at run time."""
    return fem.Constant(domain, PETSc.ScalarType(value))


def function(space):
    """A function of a space; its values are `.x.array`."""
    return fem.Function(space)


def add_vector(form, into: Floats):
    """Add a linear form's vector to an array of dofs, those of others included; of this rank's cells alone."""
    fem.assemble_vector(into, form)


def free_dropped(comm=ALONE):
    """Free what Python has dropped of PETSc in all ranks of a communicator: from 3.18 on, it waits for this."""
    if hasattr(PETSc, "garbage_cleanup"):
        PETSc.garbage_cleanup(comm)


def empty_matrix(form) -> PETSc.Mat:
    """A matrix with room for a bilinear form."""
    return petsc.create_matrix(form)


def add_matrix(form, into: PETSc.Mat):
    """Add a bilinear form's matrix to one with room for it; assemble it afterwards."""
    petsc.assemble_matrix(into, form)
