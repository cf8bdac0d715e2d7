"""The reference: hyperelastic finite elements on FEniCSx, with PD's own energies by quadrature-point stress and tangent.

Serial: meshes live on COMM_SELF, so that several solves may run in several processes. Importing this package without
dolfinx raises MissingDependencyError.
"""

from .prepared import PreparedFenicsx, prepare

__all__ = ["PreparedFenicsx", "prepare"]
