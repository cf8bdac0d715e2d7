"""Every way to a frame: METHODS has its label, colour and mark; here are those that replace the simulator.

| method             | answer                                             | needs the simulator at bind |
|--------------------|----------------------------------------------------|-----------------------------|
| Blendshapes        | T = S                                              | no                          |
| BonesCarried       | T = S carried along by the bones that p scales     | no, but a head              |
| Derivatives        | the settled neutral face, or with 52 responses     | yes                         |
| CoarsePD           | PD of few iterations a frame                       | yes, and in each frame      |
| BakedShapes        | 52 shapes simulated once                           | yes                         |
| NetworkMethod      | trained weights, alone or with exact derivatives   | no, or yes                  |

Those that learn from faces have a file each in `networks`, and solvers of other packages one in the arena.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal, NamedTuple, Protocol

import numpy as np

from ..lhm.base.mesh import Floats, Floats32
from ..reference.face.derivatives import FaceDerivatives, differentiate_head, spring_norm
from .corpus.face import Face
from .corpus.reading import Faces
from .dynamics import Swings
from .heads import Heads
from .networks.weights import Weights
from .rig import CorrectedRig, FaceModes, Rig
from .runtime import BoundSurrogate, Surrogate

PD, PD_PLAIN, PD_ANDERSON, PD_ARAP = "PD", "PD, plain", "PD, Anderson", "PD on ARAP"
PD_FIRST_ORDER = "PD, from first order"
FENICSX, FENICSX_P2, FENICSX_P2P1 = "FEniCSx", "FEniCSx, P2", "FEniCSx, P2-P1"
FENICSX_NEO_HOOKEAN = "FEniCSx, neo-Hookean"
SKFEM, SKFEM_NEO_HOOKEAN = "scikit-fem", "scikit-fem, neo-Hookean"
LIBIGL_ARAP = "libigl ARAP"
NETWORK, DERIVATIVES, NETWORK_AND_DERIVATIVES = "network", "derivatives", "network + derivatives"
SETTLED, CARRIED, BLENDSHAPES = "settled + blendshapes", "bones carried", "blendshapes"
BAKED, DIAL = "baked shapes", "dial"


class Look(NamedTuple):
    """How figures draw a method: a colour and a marker of Matplotlib."""

    colour: str
    mark: str


METHODS: Mapping[str, Look] = {
    PD: Look("#1f77b4", "s"),
    PD_PLAIN: Look("#aec7e8", "s"),
    PD_ANDERSON: Look("#6b8fd6", "s"),
    PD_ARAP: Look("#c5b0d5", "s"),
    PD_FIRST_ORDER: Look("#4c3f91", "s"),
    FENICSX: Look("#d62728", "s"),
    FENICSX_P2: Look("#8c1a1a", "s"),
    FENICSX_P2P1: Look("#a0522d", "s"),
    FENICSX_NEO_HOOKEAN: Look("#8c564b", "s"),
    SKFEM: Look("#c49c94", "s"),
    SKFEM_NEO_HOOKEAN: Look("#7a5c52", "s"),
    LIBIGL_ARAP: Look("#2ca02c", "s"),
    NETWORK: Look("#17becf", "o"),
    DERIVATIVES: Look("#006d5b", "o"),
    NETWORK_AND_DERIVATIVES: Look("#7a7a00", "o"),
    DIAL: Look("#222222", "D"),
    BAKED: Look("#bcbd22", "^"),
    SETTLED: Look("#9467bd", "^"),
    CARRIED: Look("#e377c2", "^"),
    BLENDSHAPES: Look("#ff7f0e", "^"),
}
"""The only labels of methods. Squares solve, circles use the network or derivatives, triangles are simple rivals."""
OTHER = Look("#000000", "s")
"""A method of one's own."""
Takes = Literal["nothing", "carried", "settled", "derivatives"]
"""What `bind` takes ready-made, of a head or from the simulator, though its user waits for it; see `BindCosts`."""
TOLERANCE, MOST = 5e-4, 200
"""Of a frame that is simulated to the end, as a corpus asks it, and after how many iterations it ends at the latest."""


class Method(Protocol):
    """A way to frames; `simulates` says that binding or a frame needs the simulator, whose answers `Face` has."""

    name: str
    simulates: bool
    takes: Takes

    def fit(self, faces: Faces) -> None:
        """Learn from a corpus' training faces; what learns nothing returns at once."""
        ...

    def bind(self, face: Face) -> Rig:
        """Bind one person and p. Only a method that `simulates` may use the face's offset and responses."""
        ...


class _Ready:
    """A method that learns nothing from faces."""

    name: str
    simulates = False
    takes: Takes = "nothing"

    def fit(self, faces: Faces) -> None:
        """Nothing to learn."""


class Blendshapes(_Ready):
    """T = S: the error of doing nothing."""

    name = BLENDSHAPES

    def bind(self, face: Face) -> CorrectedRig:
        """Add nothing."""
        return CorrectedRig(face.person.skin, face.shapes, lambda weights: np.float32(0.0))


class BonesCarried(_Ready):
    """T - S is by how much scaled bones carry the neutral skin, whatever the expression; it needs a head."""

    name = CARRIED
    takes: Takes = "carried"

    def __init__(self, heads: Heads):
        self._heads = heads

    def bind(self, face: Face) -> CorrectedRig:
        """Add zero where p scales no bone."""
        carried = self._heads.carry(face)
        return CorrectedRig(face.person.skin, face.shapes, lambda weights: carried)


class Derivatives(_Ready):
    """One factor and 52 solves at bind, then blendshapes; with `responses` False the settled neutral face alone."""

    simulates = True

    def __init__(self, *, responses: bool = True):
        self._responses = responses
        self.takes: Takes = "derivatives" if responses else "settled"
        self.name = DERIVATIVES if responses else SETTLED

    def bind(self, face: Face) -> BoundSurrogate:
        """Take what the corpus keeps of the face."""
        responses = face.responses.astype(np.float32) if self._responses else np.zeros(face.shapes.shape, np.float32)
        return BoundSurrogate.from_face(face, FaceModes.linear(face.offset.astype(np.float32), responses))


class NetworkMethod(_Ready):
    """Trained weights of any kind, by a name; with `exact` offset and responses are the face's.

    Raises InputError for `exact` with weights that have neither.
    """

    def __init__(self, weights: Weights, *, exact: bool = False, name: str = NETWORK):
        self._surrogate, self.simulates = Surrogate(weights), exact
        if exact:
            self._surrogate.check_exact()
        self.takes: Takes = "derivatives" if exact else "nothing"
        self.name = f"{name} + {DERIVATIVES}" if exact else name

    def bind(self, face: Face) -> Rig:
        """Bind by the run time's own arithmetic."""
        return self._surrogate.bind_face(face, exact=self.simulates)

    def swing(self, face: Face) -> Swings | None:
        """Return how a face swings by learned coefficients; None for weights without."""
        return self._surrogate.learned_swing(face)


class _Simulated:
    """A face of a corpus, simulated anew: head, settled neutral face and tangent."""

    def __init__(self, heads: Heads, face: Face):
        self.head, self.shapes = heads.fit(face), heads.shapes(face)
        self.linear: FaceDerivatives = differentiate_head(self.head, heads.parameters(face, self.head))

    def correct(self, weights, *, iterations: int | None = None) -> Floats:
        """T - S [mm], shape (n, 3), from the first-order answer by so many iterations, or to the end."""
        expression = self.head.skin.vertices + np.tensordot(weights, self.shapes, axes=1)
        neutral = self.linear.face
        scene = neutral.scene(expression)
        if iterations is None:
            solution = self.linear.solve(expression, accuracy=TOLERANCE, max_iterations=MOST)
        else:
            start, norm = self.linear.predict(expression), spring_norm(scene)
            solution = self.linear.prepared.solve(
                scene, start=start, absolute=TOLERANCE * norm, max_iterations=iterations, untangle=False
            )
        return neutral.skin_after(expression, solution.positions) - expression


class CoarsePD(_Ready):
    """The simulator stopped after some iterations a frame, which begins at the first-order answer."""

    simulates = True

    def __init__(self, heads: Heads, iterations: int):
        self._heads, self._iterations = heads, iterations
        self.name = f"PD, {iterations} iteration{'s' if iterations > 1 else ''} a frame"

    def bind(self, face: Face) -> CorrectedRig:
        """Fit, settle, factor."""
        simulated = _Simulated(self._heads, face)

        def correct(weights: Floats32) -> Floats32:
            return simulated.correct(weights, iterations=self._iterations).astype(np.float32)

        return CorrectedRig(face.person.skin, face.shapes, correct)


class BakedShapes(_Ready):
    """Each of the 52 shapes simulated at full weight, once; frames are sums of what they do."""

    simulates, name = True, BAKED

    def __init__(self, heads: Heads):
        self._heads = heads

    def bind(self, face: Face) -> BoundSurrogate:
        """Solve fifty-three times."""
        simulated = _Simulated(self._heads, face)
        offset = simulated.correct(np.zeros(52))
        shapes = np.stack([simulated.correct(unit) - offset for unit in np.eye(52)])
        return BoundSurrogate.from_face(face, FaceModes.linear(offset.astype(np.float32), shapes.astype(np.float32)))
