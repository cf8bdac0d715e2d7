"""The reference: hyperelastic finite elements on FEniCSx, and PD's own energies by quadrature-point tangents.

Serial: meshes live on COMM_SELF, so that several solves may run in several processes. Importing this package without
dolfinx raises MissingDependencyError.
"""

# First of all, since it says in one line what to install, and keeps ufl's warning of its own imports to itself.
from . import dolfinx_version
from .prepared import PreparedFenicsx, prepare

__all__ = ["PreparedFenicsx", "dolfinx_version", "prepare"]
