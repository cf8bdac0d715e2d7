"""README and docs as they stand: Python blocks run alone, and commands are read or run. `make docs` runs the programs.

A line of `RUN` is run with the words beside it put after its own: of an option given twice the last one counts. Every
other line is read: a usage error fails.
"""

import re
import shlex
from dataclasses import replace
from pathlib import Path

import click
import numpy as np
import pytest
import trimesh

from softdeca.benchmarks.studies.arena import problems
from softdeca.benchmarks.studies.arena.entrants import list_entrants
from softdeca.benchmarks.studies.arena.runs import run
from softdeca.cli.app import app
from softdeca.lhm import expressions, load_template
from softdeca.reference import Solution
from softdeca.surrogate.corpus.folder import Corpus
from softdeca.surrogate.corpus.people import OfSpace
from softdeca.surrogate.corpus.plan import PRESETS, read_plan
from softdeca.surrogate.corpus.spheres import Spheres

ROOT = Path(__file__).resolve().parents[2]
NAMES = ("README", "docs/own-head", "docs/viewer", "docs/corpus", "docs/parallel", "docs/paper", "docs/studies")
NAMES += ("docs/face-benchmark", "docs/first-hour/animator", "docs/first-hour/learner")
PAGES = [ROOT / f"{name}.md" for name in NAMES]
TEXT = "\n".join(page.read_text() for page in PAGES)

RUN = {
    "softdeca head fit --seed 3 --out head.npz": "--level 1",
    "softdeca head show head.npz --expression jawOpen*0.5": "",
    "softdeca head check head.npz": "",
    "softdeca head mesh head.npz --size 3 --out head.msh": "--size 12",
    "softdeca view head.npz --parameters p.toml --out out/view.html": "",
    "softdeca animate take.csv --head head.npz --parameters p.toml --dynamic --format glb --preview mp4": (
        "--frames 0:2 --out out/take"
    ),
    "softdeca animate take.csv --head head.npz --accuracy none --parameters p.toml --dynamic": (
        "--frames 0:2 --out out/rig"
    ),
    'softdeca animate "speech:We are here" --accuracy 0.05 --format glb': "--level 1 --frames 0:2 --out out/dialled",
    "softdeca head fit --skin scan.glb --out head.npz": "--level 1",
    "softdeca head export head.npz --parameters p.toml --out rig.glb": "",
    "softdeca bench list": "",
    "softdeca animate take.csv --head head.npz": "--frames 0:2 --out out/scan",
}


def lines(text: str) -> list[list[str]]:
    """The words of each command in a shell block, its comments left out; a quotation may go over several lines."""
    found, begun = [], ""
    for line in text.splitlines():
        begun += line + "\n"
        try:
            words = shlex.split(begun, comments=True)
        except ValueError:  # inside a quotation
            continue
        begun = ""
        if words:
            found.append(words)
    assert not begun
    return found


COMMANDS = [words for block in re.findall(r"```sh\n(.*?)```", TEXT, flags=re.DOTALL) for words in lines(block)]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Files that the pages take for granted: a scan, a take, parameters, takes, a plan."""
    folder = tmp_path_factory.mktemp("pages")
    skin = load_template(level=1).skin
    # Metres; of the template's triangles, so that it need not be registered, which test_own_head.py does.
    trimesh.Trimesh(1e-3 * skin.vertices, skin.triangles, process=False).export(folder / "scan.glb")
    (folder / "p.toml").write_text("soft_volume = 1.1\ngravity = 1.5\n")
    (folder / "takes").mkdir()
    names = [name[0].upper() + name[1:] for name in expressions.ARKIT]
    weights = np.zeros((6, 52))
    weights[:, expressions.index("jawOpen")] = np.linspace(0.0, 0.25, 6)
    rows = [f"10:00:00:{k:02d}.000,52,{','.join(map(str, row))}" for k, row in enumerate(weights)]
    (folder / "take.csv").write_text("\n".join([",".join(["Timecode", "BlendShapeCount", *names]), *rows]) + "\n")
    (plan,) = re.findall(r"```toml\n(.*?)```", TEXT, flags=re.DOTALL)
    (folder / "plan.toml").write_text(plan)
    small = replace(PRESETS["tiny"], sequences=0, responses=0.0, sources={"random": 1.0})
    Corpus.from_plan(folder / "corpus", small, OfSpace(space := Spheres(1), space.mean, space.fit)).generate()
    return folder


@pytest.mark.parametrize("words", [w for w in COMMANDS if "softdeca" in w and "://" not in w[-1]], ids=" ".join)
def test_every_command_is_read_as_it_stands(words, folder, monkeypatch):
    monkeypatch.chdir(folder)
    words = words[words.index("softdeca") + 1 :]
    command: click.Command = app
    while isinstance(command, click.Group):
        command = command.get_command(click.Context(command), words.pop(0))
    assert not command.make_context(command.name, words).args  # a usage error if it has no such option or value


def test_the_plan_is_read_as_it_stands(folder):
    plan = read_plan(folder / "plan.toml")
    assert (plan.identities, plan.groups, plan.frames, plan.sequences, plan.varying) == (200, 4, 10, 1, 0.5)


def test_what_runs_here_ends_well(folder, command, monkeypatch):
    pytest.importorskip("gmsh")
    pytest.importorskip("imageio_ffmpeg")
    monkeypatch.chdir(folder)
    for line, more in RUN.items():  # in this order: some need what others wrote
        ended = command(*shlex.split(line)[1:], *shlex.split(more))
        assert ended.status == 0, (line, ended.errors, ended.out[-500:])
    made = ("head.npz", "head.msh", "out/head", "out/view.html")
    made += ("out/take/preview.mp4", "out/scan/preview.gif", "rig.glb")
    assert all((folder / name).exists() for name in made), sorted(str(p) for p in folder.rglob("*"))


EXAMPLES = [
    block
    for page in [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
    for block in re.findall(r"```python\n(.*?)```", page.read_text(), flags=re.DOTALL)
]


@pytest.mark.parametrize("block", EXAMPLES, ids=lambda block: block[:50])
def test_a_block_runs_alone_on_the_coarsest_head(block, folder, monkeypatch):
    pytest.importorskip("dolfinx")
    pytest.importorskip("torch")
    monkeypatch.chdir(folder)
    if "TITLE =" in block:  # a solver for the arena
        (folder / "linear.py").write_text(block)
        bar = problems.make("bar")
        answers, file = [problems.answer(bar, "neo-Hookean")], str(folder / "linear.py")
        (entrant,) = (each for each in list_entrants((file,)) if each.file == file)
        assert run(entrant, bar, entrant.law, answers, 1.0, bar.vertices)["max_mm"] <= 1.5
        return
    names: dict = {}
    exec(block.replace("load_template()", "load_template(level=1)"), names)
    assert all(made.converged for made in names.values() if isinstance(made, Solution))
