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
from softdeca.benchmarks.contest import run_contest, summarise
from softdeca.benchmarks.studies.agreement.study import Agreement
from softdeca.benchmarks.studies.arena.study import WorkPrecision
from softdeca.benchmarks.studies.verification import Verification
from softdeca.reference import add_file, problems
from softdeca.surrogate import methods

add_file("gent.py")
for problem in problems.added_problems():
    for solver in problem.solvers:
        outcome = problems.run(problem, solver)
        print(
            f"{problem.name:<42} {solver:<8} {outcome.value:.10f}  error {outcome.error:.0e}  {outcome.passed}"
        )
        assert outcome.passed

# %% [markdown]
# ## In the studies
#
# The same file gives verification and `work-precision` their rows:

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
# ## Beside the others, on a face
#
# Which law is a face's? `softdeca bench --add gent.py agreement --law Gent` has Gent's law beside projective dynamics
# (PD), the neo-Hookean law, the network and its rivals, on every expression and effect, with the stress of each layer.
# `softdeca bench --add gent.py material` has it beside the package's laws on a cube. Here is one expression of that
# study, on a coarse head: how far each method's skin is from that of Gent's law, of the motion.

# %%
case = Agreement(level=1, laws=("Gent",)).make_case("jawOpen*0.8")
gent = methods.solve_law("Gent")
rivals = [methods.PD, methods.FENICSX_NEO_HOOKEAN, methods.BLENDSHAPES]
rows = run_contest(case, rivals, truths=[gent])
apart = summarise(rows, "method", truth=gent.name)
for rival in rivals:
    print(
        f"{rival:<22} {100 * apart[rival].share:5.1f} %, mean {apart[rival].everywhere:.3f} mm"
    )
assert apart[methods.FENICSX_NEO_HOOKEAN].share < apart[methods.BLENDSHAPES].share

# %% [markdown]
# A law of the package itself is such a file in `reference/materials/`, named in the `__init__.py` there. It has no
# `add_law`, so its problems stand in `reference/problems/`: see [](../extend.md).
# `neo_hookean.py` has a second form of its energy, `mixed_density`, by which mixed elements take it. A law of one's own may
# have one too, by the base `MixedLaw`.
#
# A formula may call the functions of `m` alone: log, exp, sqrt, sin, cos, tanh, arctan, where. `FUNCTIONS` of
# `reference/fenicsx/energy/law_code.py` takes one more in a line.
