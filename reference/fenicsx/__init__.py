"""The reference: hyperelastic finite elements on FEniCSx, and PD's own energies by quadrature-point tangents.

How to read it, from what is asked to what is solved:

- `prepared`: prepare and solve; which strategy a scene takes. A `run` is one call of solve, with
  the record of what its solves spend. `fields` gives stresses and functions inside the tets.
- The strategies: `minimise` (Newton's method of `newton` on an energy), `multipliers` (augmented Lagrangian, for
  elements with a pressure), `load_steps` (of the equations of `equilibrium`, for follower pressure).
- What they solve: `problem` has energy, gradient and Hessian of a scene, and the table of terms: `solids` (`kernels`
  integrate laws that `law_code` writes as C; `hyperelastic` has those with a pressure as UFL's forms), and
  what is `nodal`: `surface_strain`, `bending`, springs and following pressure of `loads`. `bodies` makes parts rigid.
- Where it lives: `numbering` is the scene's mesh and its nodes, `parallel` how ranks divide them, `assembly` the
  matrix. `linear.solvers` and, with a pressure, `saddle` solve systems, by name. `dolfinx_version` is the only module
  that knows which dolfinx there is.

Every rank makes the same calls, and a mesh is divided among them by DOLFINx. Importing this package without dolfinx
raises MissingDependencyError.
"""

# First of all, since it says in one line what to install, and keeps ufl's warning of its own imports to itself.
from . import dolfinx_version
from .prepared import PreparedFenicsx, prepare

__all__ = ["PreparedFenicsx", "dolfinx_version", "prepare"]
