# %% [markdown]
# # Bring your own head
#
# A mesh of any topology, unit and orientation becomes a head: what is wrong with it is repaired and told, a face is
# found on it, the template's skin is laid onto it, and its layers are fitted. The head is in the template's triangles.
# Here the file is a random person whose mesh was turned, scaled to metres and shuffled, as a scan would come.

# %%
import tempfile
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import trimesh

from softdeca.animation.head_pictures import draw_sections
from softdeca.lhm import check_head, expressions, identities, load_template, scans
from softdeca.lhm.head.file import load_head, save_head
from softdeca.reference import Face, Parameters, facial_scene, settle, solve
from softdeca.surrogate import METHODS


@dataclass(frozen=True)
class Picture:
    """A PNG that a notebook shows."""

    png: bytes = field(repr=False)

    def _repr_png_(self):
        return self.png


out = Path(tempfile.mkdtemp())
rng = np.random.default_rng(3)
_, someone = identities.Anny().sample(rng)
order = rng.permutation(len(someone.vertices))
turned = (
    1e-3 * someone.vertices[order] @ np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]).T
)
trimesh.Trimesh(turned, np.argsort(order)[someone.triangles], process=False).export(
    out / "scan.ply"
)

# %% [markdown]
# ## Fit
#
# The same as `softdeca head fit --skin scan.ply`. `notes` tell what was found and changed.

# %%
template = load_template(level=1)
head = scans.fit_scan(template, out / "scan.ply")
for note in head.notes:
    print(note)

# %% [markdown]
# ## Check
#
# Every gate with its figure; `softdeca head check` prints the same, and ends with status 1 where one is missed.

# %%
report = check_head(head)
for gate in report.gates:
    print(
        f"{gate.name:<28} {gate.value:>8.3g} {gate.unit:<6} {gate.direction} {gate.bound:g}"
    )
assert not report.problems
save_head(out / "head.npz", head)
head = load_head(out / "head.npz")

# %% [markdown]
# Cut open: soft tissue and muscle between the wraps of skin, muscle and skull.

# %%
Picture(draw_sections(head, head.vertices, head.skin))

# %% [markdown]
# ## Simulate
#
# The head has all expressions but tongueOut. Under 1.4 times the soft tissue it is first settled, and the
# expression's scene starts from there.

# %%
shape = head.expression(expressions.weights_of({"jawOpen": 0.6, "mouthSmileLeft": 0.5}))
solution = solve(facial_scene(head, Parameters(), shape))
heavier = settle(head, Parameters(soft_volume=1.4))
print(solution.reason)
print(
    f"under 1.4 times the volume the skin moves by up to {np.abs(heavier.skin - head.skin.vertices).max():.1f} mm"
)
assert solution.converged and heavier.solution.converged

# %% [markdown]
# ## Play
#
# A rig takes the simulator's derivatives; a frame is then as cheap as blendshapes.

# %%
rig = METHODS["derivatives"].bind(Face(head, head.rig.deltas))
frame = rig.frame(expressions.weights_of({"jawOpen": 0.6, "mouthSmileLeft": 0.5}))
answer = head.skin_after(shape, solution.positions[: len(head.bone)])
error, nothing = (
    np.linalg.norm(skin - answer, axis=1).mean() for skin in (frame, shape)
)
print(f"to the simulation, mean: rig {error:.3f} mm, blendshapes {nothing:.3f} mm")
assert error < nothing

# %% [markdown]
# `softdeca view head.npz` opens a live page with sliders for expressions and p, and `softdeca animate take.csv --head
# head.npz` plays a recording.
