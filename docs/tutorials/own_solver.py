# %% [markdown]
# # Bring your own solver
#
# A solver is one file: a function `prepare(scene)`, whose result has `solve`. It takes the same scenes as the
# others and refuses by name what it cannot model. This one minimises by L-BFGS with a Laplacian as its first guess
# of the Hessian, in numpy.
#
# ```{literalinclude} quasi_newton.py
# :language: python
# ```
#
# ## Verification
#
# `add_file` runs the file (in a shell: `softdeca bench --add quasi_newton.py NAME`). From then on every problem is
# posed to the solver, within the loosest bound that any solver has there. Those that it refuses are left out, with
# its words.

# %%
import numpy as np

from softdeca.benchmarks.studies.arena.entrants import Entrant
from softdeca.benchmarks.studies.arena.laws import RIGID
from softdeca.benchmarks.studies.arena.problems import pull_handles
from softdeca.benchmarks.studies.arena.runs import run
from softdeca.benchmarks.studies.arena.study import WorkPrecision
from softdeca.benchmarks.studies.verification import Hard, Verification
from softdeca.lhm import expressions, fit_head, identities, load_template
from softdeca.reference import (
    NotModelledError,
    add_file,
    prepare,
    problems,
)

add_file("quasi_newton.py")
NAME = "quasi-newton"
outcomes, refused = [], {}
for problem in problems.ALL:
    if NAME in problem.solvers:
        try:
            outcomes.append(problems.run(problem, NAME))
        except NotModelledError as words:
            refused.setdefault(str(words).split(";")[0], []).append(problem.name)
failed = [outcome for outcome in outcomes if not outcome.passed]
print(
    f"{len(outcomes) - len(failed)} of {len(outcomes)} values are within their bounds"
)
for words, which in refused.items():
    print(f"{len(which):>3} left out: {words}")
assert not failed, failed

# %% [markdown]
# ## Hard cases
#
# Here a solver is pushed to where it may fail. This one comes through, slowly: a bar drawn to ten times its length takes
# a thousand iterations. Where it fails it has to say so: "missed", a wrong answer called right, is never allowed.

# %%
for case in problems.HARD:
    if (NAME, "P1") in case.ways:
        try:
            outcome = problems.run_hard(case, NAME)
        except NotModelledError:
            continue
        print(
            f"{case.name:<36} {outcome.outcome:<15} error {outcome.error:.0e}, {outcome.iterations} iterations"
        )
        assert outcome.outcome != "missed"

# %% [markdown]
# ## Work-precision
#
# Error against time, beside projective dynamics, on the tets of a face with the energy of as-rigid-as-possible
# deformation, which both model. The truth is a tight run.

# %%
import matplotlib.pyplot as plt

space = identities.Anny()
code, skin = space.sample(np.random.default_rng(0))
head = fit_head(load_template(level=1), skin)
shape = expressions.blend(space, code, expressions.weights_of({"jawOpen": 0.3}))[0]
problem = pull_handles(head, shape)
truth = prepare(problem.scene(RIGID)).solve(tolerance=1e-10).positions
figure, axis = plt.subplots(figsize=(6, 3.2))
for solver in ("projective", NAME):
    entrant = Entrant(solver, "default", RIGID, {"solver": solver})
    found = run(entrant, problem, RIGID, [truth], 30.0, problem.vertices)
    axis.loglog(found["seconds"][1:], found["error_mm"][1:], label=solver)
    print(f"{solver:<13} to 0.01 mm in {found['to_hundredth_s']:.2f} s")
axis.set(xlabel="time of the solve [s]", ylabel="largest error of a vertex [mm]")
axis.legend(frameon=False)
axis.grid(alpha=0.25)
figure.tight_layout()

# %% [markdown]
# ## In the studies
#
# The same file gives all three studies their rows:

# %%
for command, study in (
    ("verification", Verification()),
    ("hard", Hard()),
    ("work-precision", WorkPrecision()),
):
    tasks = [task for task in study.tasks() if NAME in str(task)]
    print(
        f"softdeca bench --add quasi_newton.py {command:<25} {len(tasks):>3} rows, such as: {tasks[0]}"
    )
    assert tasks
