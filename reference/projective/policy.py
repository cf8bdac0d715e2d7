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
    patience_at_rounding: int = 20  # the same where the gradient is as small as rounding may be
    mixed: int = 10  # steps that Anderson's method mixes
    rounding: float = 1e-13  # of the energy: lesser differences are rounding
    untangled: float = 1e-5  # of the gradient: tets have come out as far as they will
    max_untangling: int = 150  # iterations on the energy that leads out of inverted tets


@dataclass(frozen=True)
class NewtonStepPolicy:
    """Newton's step by conjugate gradients; see `newton_step`."""

    most_products: int = 8  # with the Hessian: by then a step that is not near its end seldom comes there
    near: float = 0.25  # of the whole step's motion: a last part below it says that the step is near its end
    pushed: float = 4.0  # by which the way left is raised where surfaces push: it was seen to be up to 3.8 times as far
    difference: float = 1e-4  # [mm] at most by which vertices are moved for a product with the Hessian


@dataclass(frozen=True)
class ContactPolicy:
    """Contact of a surface with itself and with obstacles; see `contact.descent` and `contact.surfaces`."""

    offset: float = 0.005  # [mm] beyond the gap: stiff contact acts below it, and so holds the gap itself
    touching: float = 5e-4  # [mm] at rest, below which surfaces are drawn back by the offset: nothing can part them
    reach: float = 0.2  # [mm] within which pairs are rows at least: a step's gaps that may close are among them
    slack: float = 0.1  # [mm] that vertices may move on before pairs are sought anew
    kept: float = 0.2  # of a pair's distance that a step leaves at least
    before: float = 0.999  # of the share at which a step would meet something
    led: float = 0.1  # [mm] of the way of what is held, made at once where it meets something
    following: int = 5  # iterations after it
    stage: float = 1.0  # [mm] of the way of what is held, on which pairs are sought at once
    apart: float = 1e-3  # of a distance, or of a stage: what comes so near, or so far only, has met
    passes: int = 12  # of active sets in an iteration at most; the next one goes on
    settled: float = 1e-2  # of the offset, by which forces' depths may still differ at the end of a pass
    closed: float = 1e-9  # [mm] of depth in the model, above which a row is pressed
    least: float = 1e-4  # of a step as it is bounded: the memory is emptied where no more of it lowers the energy


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
