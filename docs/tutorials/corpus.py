# %% [markdown]
# # Make a corpus and train
#
# A corpus holds simulated faces beside their blendshapes, of random people under random materials; a surrogate
# learns from it. Both at full size take hours (`softdeca corpus generate --preset small`, `softdeca train`). Here
# the people are spheres of 42 vertices, and the same pipeline takes seconds.
#
# ## A plan
#
# The plan alone says what a corpus holds: each frame follows from it, on any machine, by any number of processes.
# The last people are for test, and share no person, no parameters and no recording with training.

# %%
import tempfile
from pathlib import Path

import numpy as np

from softdeca.benchmarks.contest import summarise
from softdeca.benchmarks.studies.surrogate.scores import CORPUS, run_trials
from softdeca.reference import Parameters
from softdeca.surrogate import Surrogate
from softdeca.surrogate.corpus.folder import Corpus
from softdeca.surrogate.corpus.people import OfSpace
from softdeca.surrogate.corpus.plan import CorpusPlan
from softdeca.surrogate.corpus.reading import Faces, Table
from softdeca.surrogate.corpus.spheres import Spheres
from softdeca.surrogate.methods import ready_methods
from softdeca.surrogate.networks.modal_training import ModalTraining, train_modal
from softdeca.surrogate.trials import static_trials

plan = CorpusPlan(
    identities=14, groups=3, frames=6, sequences=0, varying=0.0,
    kinds={"single": 0.5, "both": 0.5}, sources={"random": 1.0}, conversations=0, random=8,
)  # fmt: skip
space = Spheres(1)
people = OfSpace(space, space.mean, space.fit)
out = Path(tempfile.mkdtemp())
corpus = Corpus.from_plan(out / "corpus", plan, people)
print(corpus.generate())

# %% [markdown]
# A corpus that was stopped goes on where it was, and a damaged shard is found by its checksum and made anew.
#
# ## What is in it
#
# Rows are dictionaries of arrays, read by numpy alone: T is `corrected`, what the simulator made, S is the skin by
# blendshapes.

# %%
table = Table(out / "corpus", "statics", "train")
row = table[0]
print(
    f"{len(table)} frames; "
    + ", ".join(f"{key} {np.shape(value)}" for key, value in row.items())
)

# %% [markdown]
# ## Training
#
# The network learns offset and responses, four times as many steps, and then the remainder (see [](../concepts.py)).
# Forty steps are enough here to see the loss fall, and too few, of too few people, to learn much: in the test below it
# is worse than blendshapes yet.

# %%
training, test = Faces(out / "corpus", "train"), Faces(out / "corpus", "test")
weights = train_modal(
    training, ModalTraining(steps=40, validate_every=10, faces=3, frames=3)
)
weights.save(out / "modal.safetensors")
curve = [dict(point) for point in weights.note.curve]
for point in curve:
    named = {
        name: f"{value:.4f}"
        for name, value in point.items()
        if name not in ("step", "seconds")
    }
    print(f"step {point['step']:>3}: {named}")
first, *_, last = (point["loss"] for point in curve if "offset" in point)
assert last < first

# %% [markdown]
# ## Test
#
# On people, parameters and expressions that it has not seen, beside what it has to beat: blendshapes carried along by
# the bones that p scales, the settled neutral face with blendshapes, and the simulator's derivatives. Shares are of the
# motion that bones alone do not explain, |T - carried(S)|.

# %%
methods = ready_methods(Surrogate(weights))
rows = run_trials(static_trials(test), *methods.values())
for name, found in summarise(rows, "method", CORPUS).items():
    print(f"{name:<34} mean {found.mean:.4f} mm, {100 * found.share:.1f} %")

# %% [markdown]
# ## Use
#
# `bind` takes a person and parameters once; a frame is then a sum of shapes.

# %%
code, skin = space.sample(np.random.default_rng(5))
rig = Surrogate.load(out / "modal.safetensors").bind(
    skin, code, Parameters(), expressions=space.expression_deltas(code)
)
frame = rig.frame(np.eye(52)[17])
print(
    f"a frame of {len(frame)} vertices, {np.abs(frame - skin.vertices).max():.2f} mm from neutral"
)
assert np.isfinite(frame).all()

# %% [markdown]
# With heads, the same is four commands, of which the first only says what it would cost:
#
# ```sh
# softdeca corpus generate --preset small --dry-run
# softdeca corpus generate --preset small --out corpus --workers 2
# softdeca train corpus --out trained
# softdeca evaluate corpus --surrogate trained/modal.safetensors --rivals
# ```
