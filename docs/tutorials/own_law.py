# %% [markdown]
# # Bring your own law
#
# A law of hyperelasticity is one file. It holds the parameters, and the energy as a formula of the three invariants.
# FEniCSx makes compiled code of the formula and its derivatives. scikit-fem evaluates it at complex numbers. A second
# form, in stretches, gives the values that verification asks for.
#
# ```{literalinclude} gent.py
# :language: python
# ```
#
# ## Verification
#
# `add_file` runs the file (in a shell: `softdeca bench --add gent.py NAME`). `add_law` first holds the formula against
# what it must give: no energy and no stress at rest, the moduli of `lame` there, infinity or no number where the law
# does not hold. It refuses a law that fails, and names F and both values.
#
# Verification poses the file's problems with the others.

# %%
import numpy as np

from softdeca.benchmarks.studies.arena.study import WorkPrecision
from softdeca.benchmarks.studies.verification import Verification
from softdeca.lhm import expressions, fit_head, identities, load_template
from softdeca.reference import (
    Parameters,
    add_file,
    apply_law,
    facial_scene,
    problems,
    solve,
)
from softdeca.reference.added import added_laws

add_file("gent.py")
gent = added_laws()["Gent"].of_moduli
for problem in problems.added_problems():
    for solver in problem.solvers:
        outcome = problems.run(problem, solver)
        print(
            f"{problem.name:<42} {solver:<8} {outcome.value:.10f}  error {outcome.error:.0e}  {outcome.passed}"
        )
        assert outcome.passed

# %% [markdown]
# ## A face of it
#
# `apply_law` puts the law in the place of projective dynamics' energy, with the moduli that each layer
# has.

# %%
space = identities.Anny()
code, skin = space.sample(np.random.default_rng(0))
head = fit_head(load_template(level=1), skin)
shape = expressions.blend(space, code, expressions.weights_of({"jawOpen": 0.8}))[0]
scene = facial_scene(head, Parameters(), shape)
fast = solve(scene)
face = solve(apply_law(scene, gent), solver="fenicsx", start=fast.positions)
n = len(head.bone)
apart = np.linalg.norm(face.positions[:n] - fast.positions[:n], axis=1)
print(
    f"{face.reason}\nPD to Gent's law, skin wrap: mean {apart.mean():.3f} mm, largest {apart.max():.2f} mm"
)
assert face.converged

# %% [markdown]
# ## In the studies
#
# The same file gives both studies their rows:

# %%
for command, study in (
    ("verification", Verification()),
    ("work-precision", WorkPrecision()),
):
    tasks = [task for task in study.tasks() if "Gent" in str(task)]
    print(
        f"softdeca bench --add gent.py {command:<25} {len(tasks):>3} rows, such as: {tasks[0]}"
    )
    assert tasks

# %% [markdown]
# A law of the package itself is such a file in `reference/materials/`, named in the `__init__.py` there. It has no
# `add_law`, so its problems stand in `reference/problems/`: see [](../extend.md).
# `neo_hookean.py` has a second form of its energy, `mixed_density`, by which mixed elements take it. A law of one's own may
# have one too, by the base `MixedLaw`.
#
# A formula may call the functions of `m` alone: log, exp, sqrt, sin, cos, tanh, arctan, where. `FUNCTIONS` of
# `reference/fenicsx/energy/law_code.py` takes one more in a line.
