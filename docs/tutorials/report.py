# %% [markdown]
# # Write a benchmark report
#
# A study is data: what there is to do, what is measured of it, and what has to hold. One runner does the rest:
# processes of their own, rows written as they come, a failure as a row with its reason, a page and a results file.
#
# ## A study that is there
#
# `softdeca bench list` names them all, and `softdeca bench NAME --help` has their options. In a shell the command
# is `softdeca bench verification --solver projective ...`; this page calls it from Python.

# %%
import json
import subprocess
import sys
import tempfile
from pathlib import Path

out = Path(tempfile.mkdtemp())


def softdeca(*arguments):
    """Return what the command prints; it ends with status 0 only where every gate holds."""
    command = [
        sys.executable,
        "-c",
        "from softdeca.cli import main; main()",
        *map(str, arguments),
    ]
    ended = subprocess.run(command, capture_output=True, text=True)
    assert ended.returncode == 0, ended.stderr
    print(ended.stdout.replace(f"{out}/", ""))


asked = (
    "--solver",
    "projective",
    "--solver",
    "skfem",
    "layers",
    "--out",
    out / "verification",
)
softdeca("bench", "verification", *asked)

# %% [markdown]
# A study that was stopped goes on where it was: rows of the same options and versions are not done again. The
# results file says by what it was made, and in every row what it took.

# %%
kept = json.loads((out / "verification" / "results.json").read_text())
print(", ".join(kept["machine"]))
print(
    {
        key: value
        for key, value in kept["rows"][0].items()
        if key not in ("values", "of")
    }
)

# %% [markdown]
# ## A study of your own
#
# A study is one file. This one asks how far projective dynamics is from Newton's answer when it is stopped early:
#
# ```{literalinclude} stopped_early.py
# :language: python
# ```
#
# Add it, and the command has it as any other:

# %%
softdeca(
    "bench",
    "--add",
    "stopped_early.py",
    "stopped-early",
    "--out",
    out / "stopped-early",
)

# %% [markdown]
# In a script, `softdeca.benchmarks.harness.run(study, folder)` does the same; as every program that starts
# processes, it needs the guard `if __name__ == "__main__":`.
#
# ## The report
#
# The results of many studies become one page, with Markdown, JSON and LaTeX tables beside it. What does not hold is
# told at its top.

# %%
results = (out / "verification", out / "stopped-early")
softdeca(
    "bench", "--add", "stopped_early.py", "report", *results, "--out", out / "report"
)
print((out / "report" / "report.md").read_text()[:900])

# %% [markdown]
# Two results of one study, from before and after a change, are compared by `softdeca bench compare before after`,
# which tells what costs changed beyond the noise of the repeats, and what answers beyond rounding.
