"""The reference: hyperelastic finite elements on FEniCSx, and PD's own energies by quadrature-point tangents.

Serial: meshes live on COMM_SELF, so that several solves may run in several processes. Importing this package without
dolfinx raises MissingDependencyError.
"""

from .prepared import PreparedFenicsx, prepare

__all__ = ["PreparedFenicsx", "prepare"]
