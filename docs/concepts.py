# %% [markdown]
# # Concepts
#
# A face's way from the weights of an expression to its skin, in the order in which the program goes it. Words are in
# the [glossary](glossary.md); figures and numbers on this page were computed as it was built.

# %% tags=["remove-input"]
import time
from dataclasses import dataclass, field

import numpy as np

from softdeca.animation.head_pictures import draw_sections
from softdeca.animation.pictures import Panel, draw_cut_away, draw_strip
from softdeca.lhm import Surface, expressions, fit_head, identities, load_template
from softdeca.reference import Face, Parameters, apply_law, facial_scene, settle, solve
from softdeca.surrogate import METHODS, Surrogate


@dataclass(frozen=True)
class Picture:
    """A PNG that the page shows."""

    png: bytes = field(repr=False)

    def _repr_png_(self):
        return self.png


space = identities.Anny()
code, skin = space.sample(np.random.default_rng(0))
head = fit_head(load_template(level=1), skin)
n = len(head.bone)
deltas = space.expression_deltas(code)
weights = expressions.weights_of(
    {"jawOpen": 0.7, "mouthSmileLeft": 0.6, "mouthSmileRight": 0.6}
)
S = expressions.blend(space, code, weights)[0]


def mean(a, b):
    """The mean distance [mm] of two skins."""
    return np.linalg.norm(a - b, axis=1).mean()


# %% [markdown]
# ## Layers and wraps
#
# A head is a skin with a skull and muscles under it. Three closed surfaces of the same triangles, the *wraps*, lie
# at skin, muscle and skull. The first is shrunk onto the skin. By default the skull's is grown inward by published
# depths, and the muscles' lies between. What is between two wraps is a layer of prisms, three tets each: soft tissue
# outside, muscle inside. The skull wrap knows which of its vertices are cranium, mandible, or free.

# %% tags=["remove-input"]
Picture(draw_cut_away(head))

# %% tags=["remove-input"]
print(
    f"{n:,} vertices a wrap, {len(head.soft.tets):,} tets of soft tissue and {len(head.muscle.tets):,} of muscle"
)
Picture(draw_sections(head, head.vertices, head.skin))

# %% [markdown]
# The skin itself keeps its own mesh, with details finer than the wrap's. Displacements go to and fro by fixed weights
# (`wrap_targets`, `skin_after`), and these details are kept. Heads come from an identity space by a
# code h, or from [a scan of your own](tutorials/own_head.py).
#
# ## Scenes and terms
#
# A scene is vertices, tets and a list of terms; every solver takes the same one, and builds no more than is in it.
# `facial_scene` makes that of a face from a head, parameters p and a skin:

# %%
scene = facial_scene(head, Parameters(), S)
for term in scene.terms:
    print(term.name)

# %% [markdown]
# *Strain* holds the shape of each tet, *Volume* its volume, *SurfaceStrain* is the skin's own, and bones are held
# or carried. A mesh of your own is a scene as well, with terms of your choice.
#
# ## Targets
#
# Blendshapes give a skin S at once, and know nothing of tissue: it may lose volume, or pass through itself. The
# scene is given S as *targets*, springs that draw the skin wrap there; where it comes to rest against the other
# terms is T.

# %%
solution = solve(scene)
T = head.skin_after(S, solution.positions[:n])
print(solution.reason)
assert solution.converged
print(
    f"mean |T - S| {mean(T, S):.3f} mm, largest {np.linalg.norm(T - S, axis=1).max():.2f} mm"
)

# %% tags=["remove-input"]
triangles = head.skin.triangles
away = np.linalg.norm(T - S, axis=1)
panels = [
    Panel("neutral", head.skin),
    Panel("S, blendshapes: the target", Surface(S, triangles)),
    Panel("T, simulated", Surface(T, triangles)),
    Panel("|T - S|", Surface(T, triangles), away, 0.5),
]
Picture(draw_strip(panels, rest=head.skin))

# %% [markdown]
# ## Settling
#
# Targets would hold a face where the scan was, whatever p says: forty percent more tissue, or three times its
# weight, would hardly show. So the neutral face is first *settled*: it comes to rest under p without any
# expression, and the expression's scene starts from there.

# %%
parameters = Parameters(soft_volume=1.4)
face = settle(head, parameters)
print(f"the skin moves by {mean(face.skin, head.skin.vertices):.2f} mm on average")

# %% [markdown]
# ![Neutral and smile, and both with 40 % more soft tissue: cheeks and jaw line fill](weight.png)
#
# ## Projective dynamics and finite elements
#
# Projective dynamics (PD) minimises its energy by two steps in turn: each tet finds the shape it would like to
# have, then one linear system, factored once, brings them together. It is fast, and right only as far as its energy
# stands for tissue and its iterations have come. FEniCSx minimises by Newton's method. Given the same energy it
# must end in the same place, which tests the solvers; given the neo-Hookean law of the same moduli it says what
# PD's energy leaves out, which tests the model.
#
# Targets hold the skin of an expression, so laws hardly differ there. Where p changes the neutral face, each law has
# to settle it itself: targets that hold PD's settled face would hide most of the difference.

# %%
exact = solve(scene, solver="fenicsx", tolerance=1e-9)
real = solve(
    apply_law(scene, "neo-Hookean"),
    solver="fenicsx",
    start=solution.positions,
    tolerance=1e-9,
)
assert exact.converged and real.converged
for name, other in (("same energy", exact), ("neo-Hookean law", real)):
    apart = np.linalg.norm(other.positions[:n] - solution.positions[:n], axis=1)
    print(
        f"PD to FEniCSx, {name:<16} mean {apart.mean():.1e} mm, largest {apart.max():.1e} mm"
    )
for name, one in (("PD", solution), ("FEniCSx", exact)):
    print(f"{name:<8} {one.times.solve:.2f} s, {one.iterations} iterations")
by_law = settle(head, parameters, law="neo-Hookean")
print(
    f"40 % more soft tissue: the law moves the skin by {mean(by_law.skin, face.skin):.3f} mm"
)

# %% [markdown]
# ![An open jaw simulated, and the errors of blendshapes, neo-Hookean law and surrogate as colours](jaw-open.png)
#
# A third code, scikit-fem, shares nothing with either and says how right FEniCSx is. [Validate a
# solver](tutorials/validate.py) goes through the three.
#
# ## Responses
#
# How T follows w is nearly linear. The derivatives of the settled face by the 52 weights, its *responses*, come out
# of one factorisation of the exact tangent; the method *derivatives* makes them a rig. Colours: how far a response goes
# beyond the blendshape that it belongs to.

# %%
linear = METHODS["derivatives"].bind(Face(head, deltas))
print(
    f"mean distance to T: blendshapes {mean(S, T):.3f} mm, with responses {mean(linear.frame(weights), T):.3f} mm"
)

# %% tags=["remove-input"]
panels = []
for name in ("jawOpen", "mouthSmileLeft", "cheekPuff"):
    one = expressions.weights_of({name: 1.0})
    response = linear.frame(one)
    beyond = np.linalg.norm(
        response - (head.skin.vertices + np.tensordot(one, deltas, axes=1)), axis=1
    )
    panels.append(Panel(name, Surface(response, triangles), beyond, 0.5))
Picture(draw_strip(panels, rest=head.skin))

# %% [markdown]
# ## The surrogate
#
# A network has learned the same from simulated faces of many people, as
#
#     T - S = o(p, h) + Σ w_j r_j(p, h) + N(w; p, h),
#
# the *offset* that p makes of the neutral face, the *responses*, and the *remainder* that is not linear in w.
# Binding it to a person and p evaluates all that does not depend on w; a frame is then a sum of shapes.

# %%
surrogate = Surrogate.load()
rig = surrogate.bind(skin, code, Parameters())
rig.frame(weights)
begin = time.perf_counter()
for _ in range(100):
    played = rig.frame(weights)
print(
    f"{10 * (time.perf_counter() - begin):.2f} ms a frame, mean distance to T {mean(played, T):.3f} mm"
)

# %% [markdown]
# (T of this page is simulated on a coarser head than those that the network learned from.) It knows the people and
# parameters that it was trained on: its [model card](surrogate.md) has its errors and limits, and `bind(...,
# exact=True)` takes offset and responses from the simulator where they matter. [Make a corpus and
# train](tutorials/corpus.py) makes one from the beginning.
