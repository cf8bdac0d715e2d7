"""Constants of the solver as values: one frozen dataclass per part, with their reasons.

`prepare(scene, policy=ProjectivePolicy(...))` takes others. Constants of compiled kernels stay in their files.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class DescentPolicy:
    """Ways down; see `descent`. Shares of an energy are of its size, those of a gradient of the first norm."""

    armijo: float = 1e-4  # of the predicted decrease, that a step has to reach
    halvings: int = 6  # of an L-BFGS step, before one along -A⁻¹ ∇E is taken
    safe_halvings: int = 40  # of a step along -A⁻¹ ∇E
    patience: int = 200  # iterations without a better point, after which a descent has stagnated
    mixed: int = 10  # steps that Anderson's method mixes
    rounding: float = 1e-13  # of the energy: lesser differences are rounding
    untangled: float = 1e-5  # of the gradient: tets have come out as far as they will
    max_untangling: int = 150  # iterations on the energy that leads out of inverted tets


@dataclass(frozen=True)
class NewtonStepPolicy:
    """Newton's step by conjugate gradients; see `newton_step`."""

    most_products: int = 8  # with the Hessian: by then a step that is not near its end seldom comes there
    near: float = 0.25  # of the whole step's motion: a last part below it says that the step is near its end
    difference: float = 1e-4  # [mm] at most by which vertices are moved for a product with the Hessian


@dataclass(frozen=True)
class ContactPolicy:
    """Contact of a surface with itself; see `contact.solver` and `contact.detection`."""

    patience: int = 10  # rounds without a lesser depth, after which contact is given up
    allowed_depth: float = 0.05  # [mm], up to which surfaces may overlap in the end
    parted: float = 0.02  # [mm] of depth, below which a descent goes on to the end
    loose: float = 0.03  # of the first gradient norm: ends a descent while surfaces are deeper than `parted`
    step: float = 1.0  # [mm] that no vertex of the surface goes further between two looks for contact
    looks: int = 3  # rounds of looking and pushing at one place at most
    nearly: float = 0.1  # [mm] of depth, with which the way goes on
    sweeps: int = 200  # of Gauss-Seidel at most; the descent that follows makes up for what they leave
    reach: float = 15.0  # [mm] behind the surface that flesh is looked through: the deepest overlap seen
    on_a_face: float = 1e-6  # a vertex with a lesser barycentric weight in a tet touches it only
    turned: float = 0.3  # cosine of a triangle's normal with a vertex' own, above which it did not go in there
    parallel: float = 0.1  # sine between edges, below which they have no direction to be parted in
    touching: float = 1e-3  # [mm]: a shorter gap has no direction
    margin: float = 1.0  # of a mean edge, beyond the thickness: nearer vertices are watched before they touch


@dataclass(frozen=True)
class ProjectivePolicy:
    """All constants of the solver; see `solver`."""

    descent: DescentPolicy = DescentPolicy()
    newton_step: NewtonStepPolicy = NewtonStepPolicy()
    contact: ContactPolicy = ContactPolicy()
    max_iterations: int = 5000
    volume_share: float = 1.0  # of Volume's weight in the matrix; see `Energy.matrix`
    # The same for L-BFGS, where .15 to .5 do about as well: on three expressions of a head 54, 29 and 39 iterations to
    # .01 mm instead of 77, 49 and 60 with a share of 1.
    volume_share_lbfgs: float = 0.3

    def volume_share_of(self, method: str) -> float:
        """Return the share of Volume's weight in a method's matrix."""
        return self.volume_share_lbfgs if method == "lbfgs" else self.volume_share


POLICY = ProjectivePolicy()
"""The constants as they were measured."""
