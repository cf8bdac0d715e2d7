# %% [markdown]
# # Validate a solver
#
# Is projective dynamics (PD) right, and where not? Three questions, each with a number: does a solver give closed
# forms and published values, do two independent codes agree on a face, and what does another law make of that face?

# %%
import numpy as np

from softdeca.lhm import expressions, fit_head, identities, load_template
from softdeca.reference import (
    Parameters,
    SceneError,
    apply_law,
    facial_scene,
    problems,
    solve,
)

# %% [markdown]
# ## Known answers
#
# A verification problem is a scene, a quantity of its solution, and the value that this must have, with its source.
# There are more than a hundred (`problems.ALL`); `softdeca bench verification` runs them all. Here is a bar that
# hangs under its own weight, by every solver that models it.

# %%
problem = next(
    problem for problem in problems.ALL if problem.name == "bar under its own weight"
)
print(f"{problem.name} ({problem.source}): {problem.reference:.6g}")
for solver in problem.solvers:
    outcome = problems.run(problem, solver)
    print(
        f"  {solver:<12} {outcome.value:.9g}  error {outcome.error:.1e}, at most {outcome.bound:.0e}: {outcome.passed}"
    )
    assert outcome.passed

# %% [markdown]
# A solver that cannot model a scene says so by name, before it solves anything:

# %%
law_only = next(
    problem for problem in problems.ALL if problem.name.startswith("NeoHookean")
)
try:
    solve(law_only.scene(), solver="projective")
except SceneError as refused:
    print(refused)

# %% [markdown]
# ## Two codes on one face
#
# A random person of the default space, on the coarsest of the template's levels, opens the jaw. `facial_scene`
# makes the scene of it, `solve` takes it to any solver. Look at `converged` and `reason` first: a solver that stops
# early says why.

# %%
space = identities.Anny()
code, skin = space.sample(np.random.default_rng(0))
head = fit_head(load_template(level=1), skin)
shape = expressions.blend(space, code, expressions.weights_of({"jawOpen": 0.8}))[0]
scene = facial_scene(head, Parameters(), shape)

fast = solve(scene, solver="projective", tolerance=1e-9)
exact = solve(scene, solver="fenicsx", tolerance=1e-9)
for name, solution in (("projective", fast), ("FEniCSx", exact)):
    print(
        f"{name:<11} {solution.iterations:>3} iterations, {solution.times.solve:.2f} s; {solution.reason}"
    )
apart = np.linalg.norm(fast.positions - exact.positions, axis=1).max()
moved = np.linalg.norm(exact.positions - scene.vertices, axis=1).max()
print(
    f"farthest vertices: {apart:.1e} mm apart, where the face moves by {moved:.1f} mm"
)
assert fast.converged and exact.converged and apart < 1e-3 * moved

# %% [markdown]
# They minimise the same energy by code that they do not share, so the distance is an error of the solvers alone.
#
# ## Another law
#
# `apply_law` puts the neo-Hookean law of the same moduli at rest in the place of PD's energy. That distance
# is what the *model* leaves out, and no tolerance makes it smaller.

# %%
real = solve(
    apply_law(scene, "neo-Hookean"),
    solver="fenicsx",
    start=fast.positions,
    tolerance=1e-9,
)
n = len(head.bone)
model = np.linalg.norm(fast.positions[:n] - real.positions[:n], axis=1)
blendshapes = np.linalg.norm(head.wrap_targets(shape) - real.positions[:n], axis=1)
print(
    f"to the neo-Hookean law, mean of the skin wrap: PD {model.mean():.3f} mm, blendshapes {blendshapes.mean():.3f} mm"
)
assert real.converged and model.mean() < blendshapes.mean()

# %% [markdown]
# ## Error against time
#
# Every solution has its history, so one solve gives a whole curve. Errors of PD on its way, against FEniCSx'
# answer:

# %%
import matplotlib.pyplot as plt

errors = []
solution = solve(
    scene,
    tolerance=1e-9,
    on_iteration=lambda iteration, positions, energy, gradient: errors.append(
        np.linalg.norm(positions - exact.positions, axis=1).max()
    ),
)
figure, axis = plt.subplots(figsize=(6, 3.2))
axis.loglog(1e3 * solution.history.time[1:], errors[1:])
axis.set(xlabel="time of the solve [ms]", ylabel="largest error of a vertex [mm]")
axis.grid(alpha=0.25)
figure.tight_layout()

# %% [markdown]
# The studies `verification`, `hard`, `work-precision` and `split` ask the same of all expressions, solvers,
# elements and seeds: [](report.py) shows how to run them.
