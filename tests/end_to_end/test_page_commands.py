"""Every command in a shell block of README and docs is read as it stands, and run, long ones with smaller options.

A line of `RUN` is run with the words beside it put after its own: of an option given twice the last one counts. One
of `ELSEWHERE` would take minutes however small, so that another test runs its work; one of `NOT_HERE` needs what a
test has not. A new line has to be put into one of the three.
"""

import ast
import re
import shlex
from pathlib import Path

import click
import numpy as np
import pytest
import trimesh

from softdeca.cli.app import app
from softdeca.lhm import expressions, load_template
from softdeca.surrogate.corpus.plan import read_plan

ROOT = Path(__file__).resolve().parents[2]
NAMES = ("README", "docs/own-head", "docs/viewer", "docs/corpus", "docs/parallel", "docs/paper", "docs/studies")
NAMES += ("docs/face-benchmark",)
PAGES = [ROOT / f"{name}.md" for name in NAMES]
TEXT = "\n".join(page.read_text() for page in PAGES)

RUN = {
    "softdeca head fit --seed 3 --out head.npz --vtk layers --picture head.png": "--level 1",
    "softdeca head check head.npz": "",
    "softdeca head mesh head.npz --size 3 --out head.msh": "--size 12",
    "softdeca head show head.npz --expression jawOpen*0.5": "",
    "softdeca view head.npz --parameters p.toml --out out/view.html": "",
    "softdeca animate take.csv --head head.npz --parameters p.toml --dynamic --format gltf --preview mp4": (
        "--frames 0:2 --out out/take"
    ),
    "softdeca animate take.csv --head head.npz --accuracy none --parameters p.toml --dynamic": (
        "--frames 0:2 --out out/rig"
    ),
    "softdeca animate take.csv --head head.npz --accuracy 0.01 --format gltf": "--frames 0:2 --out out/dialled",
    "softdeca head fit --skin scan.glb --out head.npz": "--level 1",
    "softdeca bench list": "",
    "softdeca animate take.csv --head head.npz": "--frames 0:2 --out out/scan",
}
CORPUS = "test_corpus_command.py::test_a_corpus_from_plan_to_picture"
ELSEWHERE = {
    "softdeca view head.npz": "test_live_view.py::test_each_answer_is_pythons_own",
    "softdeca study --identities ict:ict_facekit.npz --out out/ict": (
        "test_head_default.py::test_template_passes_its_gates"
    ),
    "softdeca study --expressions jawOpen*0.5,cheekPuff": ("test_agreement.py::test_the_study_of_a_sphere"),
    "softdeca train corpus --out trained": (
        "test_train_command.py::test_what_is_simulated_is_learned_from_and_tested_on"
    ),
    "softdeca evaluate corpus --rivals --out scores": (
        "test_train_command.py::test_what_is_simulated_is_learned_from_and_tested_on"
    ),
    "softdeca evaluate fresh --people all --out scores": (
        "test_train_command.py::test_what_is_simulated_is_learned_from_and_tested_on"
    ),
    "softdeca evaluate corpus --curve half.safetensors --curve all.safetensors": (
        "test_train_command.py::test_errors_over_the_number_of_people_are_told_of_networks_trained_on_shares"
    ),
    "softdeca evaluate corpus --generalisation 16": (
        "test_generalisation.py::test_each_combination_has_its_people_parameters_and_recordings"
    ),
    "softdeca head import ict ICT-FaceKit": "test_imports.py::test_a_folder_of_facekits_form_becomes_a_space",
    "softdeca head import bodyparts3d isa_BP3D_4.0_obj_99": (
        "test_imports.py::test_a_folder_of_bodyparts_becomes_anatomy"
    ),
    "softdeca head template --identities ict:ict_facekit.npz --anatomy bodyparts3d_head.npz --out template.npz": (
        "test_anatomical_template.py::test_template_and_fit"
    ),
    "softdeca head personalise head.npz scans/weights.json --out own.npz": (
        "test_personalise.py::test_the_rig_becomes_the_persons"
    ),
    "softdeca head train-regressor pairs/": (
        "test_train_regressor.py::test_pairs_become_a_regressor_a_report_and_a_picture"
    ),
    "softdeca head show head.npz --expression jawOpen": (
        "test_own_head.py::test_it_is_shown_and_simulated_without_a_word_more"
    ),
    "softdeca bench agreement": "test_agreement.py::test_the_study_of_a_sphere",
    "softdeca bench agreement --cases effects": "test_effects.py::test_palsy_is_measured",
    "softdeca bench arena": "test_arena.py::test_our_solvers_meet_fenicsx_and_the_study_writes_its_page",
    "softdeca bench work-precision": "test_studies.py::test_a_study_of_a_sphere_from_its_tasks_to_its_page",
    "softdeca bench scaling --cases throughput": "test_studies.py::test_a_study_of_a_sphere_from_its_tasks_to_its_page",
    "softdeca bench scaling": "test_studies.py::test_a_study_of_a_sphere_from_its_tasks_to_its_page",
    "softdeca bench scaling --cases pieces": "test_studies.py::test_a_study_of_a_sphere_from_its_tasks_to_its_page",
    "softdeca bench verification --cases hard": "test_hard_cases.py::test_bench_hard_prints_a_row_per_case_and_solver",
    "softdeca bench verification --cases hard --laws": "test_hard_cases.py::test_hard_case",
    "softdeca bench mesh": "test_bench_convergence.py::test_every_mesh_is_solved_and_the_finest_is_nearest",
    "softdeca bench agreement --cases contact --corpus corpus": (
        "test_bench_contact.py::test_frames_of_a_corpus_are_solved_with_contact"
    ),
    "softdeca bench agreement --cases motion": "test_bench_dynamics.py::test_what_the_study_shows_on_a_small_sphere",
    "softdeca bench heads --cases closures --dynamic": "test_animate.py::test_gaps_of_lids_and_lips_are_drawn",
    "softdeca bench heads --count 1000": "test_bench_heads.py::test_each_head_is_that_of_its_seed",
    "softdeca bench heads --count 2 --head own.npz": "test_bench_heads.py::test_the_gallery_shows_a_head_as_it_moves",
    "softdeca bench heads --cases registration --upon ict:ict_facekit.npz": (
        "test_bench_registration.py::test_slides_and_shapes_are_measured_and_told"
    ),
    "softdeca bench heads --cases shapes": "test_shapes.py::test_full_weights_invert_no_soft_tissue",
    "softdeca bench heads --cases depth --skin skin.ply --skull cranium.ply --skull mandible.ply": (
        "test_bench_depth.py::test_a_skull_deeper_than_predicted_by_so_much_gives_that_error"
    ),
    "softdeca bench verification --fine": "test_command.py::test_verification_prints_json_that_parses_and_passes",
    "softdeca bench scaling --cases unknowns": "test_studies.py::test_a_study_of_a_sphere_from_its_tasks_to_its_page",
    "softdeca bench surrogate --cases dial": "test_studies.py::test_a_study_of_a_sphere_from_its_tasks_to_its_page",
    "softdeca bench surrogate --cases split": "test_split.py::test_the_parts_of_an_error_and_their_check",
    "softdeca bench report": "test_report.py::test_a_report_of_studies_says_what_they_found",
    "softdeca bench surrogate --cases table-1 --corpus corpus": (
        "test_train_command.py::test_table_1_trains_what_is_missing_and_loads_the_rest"
    ),
    "softdeca bench surrogate --cases table-1 --corpus corpus --external external --trained networks": (
        "test_train_command.py::test_table_1_trains_what_is_missing_and_loads_the_rest"
    ),
    "softdeca bench surrogate --corpus corpus": (
        "test_train_command.py::test_what_is_simulated_is_learned_from_and_tested_on"
    ),
    "softdeca bench agreement --cases cube": "test_studies.py::test_the_law_that_pd_stands_for",
    "softdeca bench compare before after": "test_harness.py::test_the_command_makes_its_options_of_the_studys_fields",
    "softdeca bench mesh --cases locking": "test_studies.py::test_a_study_of_a_sphere_from_its_tasks_to_its_page",
    "softdeca bench mesh --cases face": "test_face_benchmark.py::test_every_problem_has_a_limit_and_its_band",
    "softdeca bench export face-benchmark.zip": "test_face_benchmark.py::test_every_problem_has_a_limit_and_its_band",
    "softdeca bench score my-jaw.vtu --archive face-benchmark.zip": (
        "test_face_benchmark.py::test_the_command_scores_without_our_solvers"
    ),
    "softdeca bench scaling --cases mixed": "test_bench_mixed.py::test_a_sphere_keeps_its_volume",
    "softdeca bench scaling --cases parts": (
        "test_fenicsx_parts.py::test_the_study_of_parts_compares_answers_and_memory"
    ),
    "softdeca bench scaling --cases timing": "test_bench_timing.py::test_each_habit_costs_what_the_page_says",
    "softdeca bench scaling --cases corotated --sources FastCorotatedFEM": (
        "test_bench_corotated.py::test_without_sources_theirs_is_skipped"
    ),
    "softdeca bench scaling --cases ranks": "test_fenicsx_mpi.py::test_the_study_of_ranks_compares_answers_and_phases",
    "softdeca corpus generate plan.toml --out corpus --workers 2": CORPUS,
    "softdeca corpus generate --preset small --takes takes/ --out corpus --dry-run": CORPUS,
    "softdeca corpus generate --preset small --out corpus": CORPUS,
    "softdeca corpus generate --preset small --takes takes/ --out corpus --workers 2": CORPUS,
    "softdeca corpus generate --out corpus --workers 2": CORPUS,
    "softdeca corpus status corpus": CORPUS,
    "softdeca corpus verify corpus": CORPUS,
    "softdeca corpus sample corpus --count 12": CORPUS,
    "mpirun --bind-to none -n 2 softdeca study": "test_harness.py::test_under_mpirun_every_rank_measures_itself",
}
NOT_HERE = {
    "make study": "minutes, and set-up as root",
    "make test": "these tests",
    "pip install dask-jobqueue": "the network",
    "python -c": "a batch queue",
    "softdeca corpus generate --preset paper --out /shared/corpus --scheduler tcp://...:PORT": "a cluster, and weeks",
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


def key(words: list[str]) -> str:
    """The line as the tables have it; of a Python script its first words."""
    return " ".join(words[:2] if words[0] == "python" else words)


def test_every_line_is_in_one_table():
    tables = [*RUN, *ELSEWHERE, *NOT_HERE]
    assert len(set(tables)) == len(tables) and set(tables) == {key(words) for words in COMMANDS}
    assert "```\n" in TEXT and not re.search(r"^```(?!sh$|python$|toml$|text$|$)", TEXT, flags=re.MULTILINE)


@pytest.mark.parametrize("where", sorted(set(ELSEWHERE.values())))
def test_the_tests_that_stand_for_a_line_are_there(where):
    file, name = where.split("::")
    (path,) = ROOT.glob(f"tests/*/{file}")
    assert name in {node.name for node in ast.parse(path.read_text()).body if isinstance(node, ast.FunctionDef)}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """What the pages take for granted: a scan, a take, parameters, takes, a plan."""
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
    return folder


@pytest.mark.parametrize("words", [w for w in COMMANDS if "softdeca" in w], ids=key)
def test_every_command_is_read_as_it_stands(words, folder, monkeypatch):
    monkeypatch.chdir(folder)
    words = words[words.index("softdeca") + 1 :]
    command: click.Command = app
    while isinstance(command, click.Group):
        command = command.get_command(click.Context(command), words.pop(0))
    context = command.make_context(command.name, words)  # a usage error if it has no such option, argument or value
    assert not context.args


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
    made = ("head.npz", "head.png", "head.msh", "layers", "out/head", "out/view.html")
    made += ("out/take/preview.mp4", "out/scan/preview.gif")
    assert all((folder / name).exists() for name in made), sorted(str(p) for p in folder.rglob("*"))
