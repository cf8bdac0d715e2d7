"""The reference: hyperelastic finite elements on FEniCSx, and PD's own energies by quadrature-point tangents.

Meshes live on COMM_SELF, so that several solves may run in several processes. Under `mpirun -n N softdeca ...`, or
after `reference.ranks.join()`, the first process solves and the others integrate their shares of the tets and hold
their rows of the linear system; it alone does what else there is (surfaces, springs, bodies, mixed elements, load
paths, factors that a march keeps). Importing this package without dolfinx raises MissingDependencyError.
"""

# First of all, since it says in one line what to install, and keeps ufl's warning of its own imports to itself.
from . import dolfinx_version
from .prepared import PreparedFenicsx, prepare

__all__ = ["PreparedFenicsx", "dolfinx_version", "prepare"]
