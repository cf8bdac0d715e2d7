"""Ctrl-C, a full disk and missing packages: one line, the right exit status, and no file left half-written."""

import json
import logging
import os
import re
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import h5py
import pytest

from softdeca.lhm import InputError
from softdeca.lhm.base.progress import silent
from softdeca.lhm.base.provenance import describe_machine
from softdeca.lhm.head.file import save_head
from softdeca.surrogate.corpus.folder import Corpus
from softdeca.surrogate.corpus.people import people_from_text
from softdeca.surrogate.corpus.plan import read_plan
from softdeca.surrogate.corpus.schedule import make_schedule

COMMAND = (sys.executable, "-c", "from softdeca.cli import main; main()")
WITHOUT = """
import sys
class Refuse:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in {missing}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)
sys.meta_path.insert(0, Refuse())
"""
MAIN = "from softdeca.cli import main; main()"
BARE = WITHOUT.format(missing=("dolfinx", "basix", "ufl", "torch", "anny"))
PLAN = """
preset = "tiny"
identities = 12
groups = 1
frames = 2
sequences = 0
references = 0
responses = 0.0
random = 4
sources = { random = 1.0 }
"""
WORK = """
import sys, time
from softdeca.surrogate.corpus.schedule import Schedule, run_items
if __name__ == "__main__":
    print("begin", file=sys.stderr, flush=True)
    for _ in run_items(time.sleep, [0.01] * 5000, on=Schedule("processes", 2)):
        print("done", file=sys.stderr, flush=True)
"""


def run(*arguments, **how):
    return subprocess.run([*COMMAND, *map(str, arguments)], capture_output=True, text=True, timeout=120, **how)


def interrupted(process, beginning):
    """Send the terminal's Ctrl-C once a line on stderr matches; the rest of stderr, of all that hold it."""
    for line in process.stderr:
        if re.match(beginning, line):
            break
    time.sleep(0.3)
    os.killpg(process.pid, signal.SIGINT)
    return process.communicate(timeout=300)[1]


def test_ctrl_c_ends_a_study_in_one_line(tmp_path):
    arguments = [*COMMAND, "bench", "verification", "--solver", "skfem", "--out", tmp_path / "study"]
    with subprocess.Popen(arguments, stderr=subprocess.PIPE, text=True, start_new_session=True) as process:
        rest = interrupted(process, "verification")
    said = [line for line in rest.splitlines() if line and not line.endswith(" s)")]
    assert process.returncode == 130
    assert said == ["softdeca: interrupted; what a study, corpus or training has finished is kept for the next run"]
    assert not (tmp_path / "study" / "index.html").exists()


MADE_OF_IT = {
    "compiled code": "raise SystemError('returned a result with an exception set') from KeyboardInterrupt()",
    "a library": "try:\n        raise KeyboardInterrupt\n    except BaseException as error:\n        "
    "raise RuntimeError('PETSc: error code 101') from error",
    "a clean-up": "try:\n        raise KeyboardInterrupt\n    finally:\n        raise InputError('no such file')",
    "an exit": "try:\n        raise KeyboardInterrupt\n    except BaseException:\n        raise SystemExit(1)",
}


@pytest.mark.parametrize("made", MADE_OF_IT)
def test_what_is_made_of_a_ctrl_c_ends_in_one_line(made, monkeypatch, command, tmp_path):
    names = {"InputError": InputError}
    exec(f"def show_progress():\n    {MADE_OF_IT[made]}", names)
    for module in ("study", "animate", "study_command", "head"):
        monkeypatch.setattr(f"softdeca.cli.{module}.show_progress", names["show_progress"])
    for words in (["study"], ["bench", "verification"], ["animate", "conversation:1"], ["head", "fit"]):
        ended = command(*words, "--out", tmp_path / ("head.npz" if words[0] == "head" else "out"))
        assert ended.status == 130 and len(ended.errors) == 1 and ended.errors[0].startswith("softdeca: interrupted; ")


SWALLOWED = """
import ctypes, os, signal, sys, time
from softdeca.cli import app
@ctypes.CFUNCTYPE(ctypes.c_int)
def called_from_c():
    os.kill(os.getpid(), signal.SIGINT)
    time.sleep(5)
    return 1
class Dropped:
    def __del__(self):
        called_from_c()
app.app.main = lambda *_, **__: {how}
app.main()
"""


@pytest.mark.parametrize("how", ["called_from_c() or time.sleep(60)", "[Dropped()].clear() or time.sleep(60)"])
def test_ctrl_c_in_a_callback_that_c_calls_is_not_lost(how):
    ended = subprocess.run(
        [sys.executable, "-c", SWALLOWED.format(how=how)], capture_output=True, text=True, timeout=60
    )
    assert (ended.returncode, ended.stderr) == (130, "softdeca: interrupted; ended at once\n")


def test_two_ctrl_c_among_compiled_loops_end_in_one_line(tmp_path):
    arguments = [*COMMAND, "head", "fit", "--level", "1", "--out", tmp_path / "head.npz"]
    with subprocess.Popen(arguments, stderr=subprocess.PIPE, text=True, start_new_session=True) as process:
        for line in process.stderr:
            if line.startswith("head: identity"):
                break
        time.sleep(0.4)
        for _ in range(2):
            process.send_signal(signal.SIGINT)
            time.sleep(0.03)
        said = [line for line in process.stderr.read().splitlines() if line and not line.endswith(" s)")]
        process.wait(60)
    # Python gives the signal back to the system as it ends: a second one may come just then.
    assert process.returncode in (130, -signal.SIGINT)
    assert len(said) == 1 and said[0].startswith("softdeca: interrupted")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("seconds", [0.02, 0.3])
def test_ctrl_c_while_modules_are_loaded_is_one_line(seconds):
    code = "import softdeca.cli; print('begin', flush=True); softdeca.cli.main()"
    with subprocess.Popen(
        [sys.executable, "-c", code, "--help"], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        process.stdout.readline()
        time.sleep(seconds)
        process.send_signal(signal.SIGINT)
        out, errors = process.communicate(timeout=60)
    assert (process.returncode, out, errors) == (130, "", "softdeca: interrupted\n")


ONE_TET = """
import numpy as np
from softdeca.lhm.base.mesh import tet_volumes
print(tet_volumes(np.eye(4)[:, 1:], np.array([[0, 1, 2, 3]])))
"""
OTHERS = all(place.stat().st_mode & 0o005 == 0o005 for place in Path(__file__).resolve().parents)


@pytest.mark.skipif(os.getuid() != 0 or not OTHERS, reason="another user, who can read this folder, is needed")
def test_where_nothing_can_be_written_a_temporary_cache_is_used_and_said_once():
    nobody = {"user": 65534, "group": 65534, "extra_groups": []}
    with tempfile.TemporaryDirectory() as folder:
        os.chmod(folder, 0o777)
        environment = {"HOME": "/nonexistent", "TMPDIR": folder, "PATH": os.environ["PATH"]}
        ended = subprocess.run(
            [sys.executable, "-c", ONE_TET], capture_output=True, text=True, env=environment, timeout=120, **nobody
        )
        assert os.listdir(folder) == ["softdeca-cache-65534"]
    assert ended.returncode == 0 and ended.stdout, ended.stderr
    assert ended.stderr.count("cannot be written") == 1


@pytest.fixture
def plan(tmp_path):
    """The file of a small plan."""
    (tmp_path / "plan.toml").write_text(PLAN)
    return tmp_path / "plan.toml"


def test_ctrl_c_ends_the_workers_of_a_corpus_and_leaves_whole_shards(plan, tmp_path):
    arguments = [*COMMAND, "corpus", "generate", plan, "--identities", "spheres:1", "--workers", "2"]
    arguments += ["--people", "400", "--out", tmp_path / "corpus"]
    with subprocess.Popen(arguments, stderr=subprocess.PIPE, text=True, start_new_session=True) as process:
        rest = interrupted(process, r"corpus: ([4-9]|\d\d+) of")
    said = [line for line in rest.splitlines() if line and not line.endswith(" s)")]
    assert process.returncode == 130 and len(said) == 1 and said[0].startswith("softdeca: interrupted"), rest
    left = sorted(p.name for p in (tmp_path / "corpus").iterdir())
    left = [name for name in left if not name.startswith(".") and not re.fullmatch(r"person-\d+\.json", name)]
    assert left[0] == "corpus.json" and left[-1] == "template.npz" and 3 < len(left) < 402
    for name in left[1:-1]:
        assert name.startswith("person-")
        with h5py.File(tmp_path / "corpus" / name) as shard:
            assert shard.keys()


def test_fenicsx_starts_no_daemon_that_prints_after_the_process_has_ended():
    pytest.importorskip("dolfinx")
    code = "import os, pathlib; import softdeca.reference.fenicsx\n"
    code += "for task in pathlib.Path('/proc/self/task').iterdir():\n    print((task / 'children').read_text(), end='')"
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120)
    assert (ended.returncode, ended.stdout) == (0, ""), ended.stderr


def test_sigterm_ends_processes_that_work_without_a_word(tmp_path):
    (tmp_path / "work.py").write_text(WORK)
    arguments = [sys.executable, tmp_path / "work.py"]
    with subprocess.Popen(arguments, stderr=subprocess.PIPE, text=True) as process:
        for line in process.stderr:
            if line == "done\n":
                break
        process.terminate()
        rest = process.stderr.read()
        process.wait(60)
    assert process.returncode == 128 + signal.SIGTERM and rest.replace("done\n", "") == ""


def test_a_cluster_one_of_whose_processes_is_killed_makes_the_same_corpus(plan, tmp_path):
    """On a Dask cluster of two processes, beside a run in this one."""
    from distributed import LocalCluster

    def make(name, address=None, on_progress=silent):
        corpus = Corpus.from_plan(tmp_path / name, read_plan(plan), people_from_text("spheres:1"))
        corpus.generate(on=make_schedule(1, address), on_progress=on_progress)
        return {path.name: path.read_bytes() for path in corpus.folder.glob("person-*.h5")}

    with LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address=None, silence_logs=logging.CRITICAL
    ) as cluster:

        def kill_one(what, share):
            if what.startswith("corpus: 5 of"):
                os.kill(next(iter(cluster.workers.values())).pid, signal.SIGKILL)

        by_cluster = make("one", cluster.scheduler_address, kill_one)
    assert len(by_cluster) == 12 and by_cluster == make("other")


@pytest.mark.parametrize(
    ("words", "out"),
    [("fit --level 1", "head.npz"), ("export given --format usd", "head.usd"), ("export given", "a.glb")],
)
def test_a_full_disk_is_named_and_leaves_nothing(tmp_path, command, mean_head, words, out):
    """The fixture has fitted a head before, so that all that a fit compiles is kept already."""
    if "usd" in words:
        pytest.importorskip("pxr")
    given, folder = tmp_path / "given.npz", tmp_path / "out"
    save_head(given, mean_head)
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (50_000, hard))
    try:
        ended = command("head", *words.replace("given", str(given)).split(), "--out", folder / out)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert ended.refusal().startswith(f"softdeca: error: {folder / out}: cannot be written")
    assert list(folder.iterdir()) == []


STRIKE = """
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <signal.h>
#include <stdio.h>
#include <string.h>
#include <sys/types.h>
#include <unistd.h>

static char folder[4096];
static int at = -1, failure, calls;

void strike(const char *below, int number, int code) {
    snprintf(folder, sizeof folder, "%s/", below);
    at = number; failure = code; calls = 0;
}
int counted(void) { return calls; }

static int struck(const char *path) {
    if (!*folder || strncmp(path, folder, strlen(folder)) || calls++ != at) return 0;
    if (!failure) kill(getpid(), SIGKILL);
    errno = failure;
    return 1;
}
static int struck_file(int file) {
    char link[64], path[4096];
    snprintf(link, sizeof link, "/proc/self/fd/%d", file);
    ssize_t length = readlink(link, path, sizeof path - 1);
    if (length < 0) return 0;
    path[length] = 0;
    return struck(path);
}
#define REAL(name) ((__typeof__(&name))dlsym(RTLD_NEXT, #name))
ssize_t write(int f, const void *b, size_t n) {
    if (!struck_file(f)) return REAL(write)(f, b, n);
    int told = errno;
    if (n > 1) (void)!REAL(write)(f, b, n / 2);  // a full disk takes a part
    errno = told;
    return -1;
}
ssize_t pwrite64(int f, const void *b, size_t n, off64_t o) {
    return struck_file(f) ? -1 : REAL(pwrite64)(f, b, n, o);
}
int fsync(int f) { return struck_file(f) ? -1 : REAL(fsync)(f); }
int fdatasync(int f) { return struck_file(f) ? -1 : REAL(fdatasync)(f); }
int ftruncate64(int f, off64_t n) { return struck_file(f) ? -1 : REAL(ftruncate64)(f, n); }
int rename(const char *a, const char *b) { return struck(b) ? -1 : REAL(rename)(a, b); }
int renameat(int d, const char *a, int e, const char *b) { return struck(b) ? -1 : REAL(renameat)(d, a, e, b); }
"""
"""Fails the n-th write, sync or rename below a folder, or ends the process there."""

STRUCK = """
import ctypes, errno, json, os, sys
from functools import cache
from pathlib import Path
from shutil import rmtree
from softdeca.cli import main
from softdeca.lhm.base import provenance
from softdeca.surrogate.corpus import folder, plan as plans, sequences

shim, place = ctypes.CDLL(os.environ["LD_PRELOAD"]), Path(sys.argv[1])
plan = place / "plan.toml"
options = ['preset = "tiny"', "identities = 2", "frames = 1", "run = 3", "references = 0", "responses = 0.0"]
plan.write_text(os.linesep.join(options))
known = {}

def once(function):
    # Files are what is tried: people, and all else, are made once.
    def remember(plan, people, what, *others):
        key = what if isinstance(what, int) else None
        if key not in known:
            known[key] = function(plan, people, what, *others)
        return known[key]
    return remember

folder.simulate_person, sequences._run = once(folder.simulate_person), once(sequences._run)
plans.recordings, provenance.describe_machine = cache(plans.recordings), cache(provenance.describe_machine)

def generate(out, at=-1, code=0):
    # Status, what was said, and the number of writes.
    sys.argv = ["softdeca", "corpus", "generate", str(plan), "--identities", "spheres:1", "--out", str(out)]
    with open(place / "said", "w") as file:
        os.dup2(file.fileno(), 1)
        os.dup2(file.fileno(), 2)
    shim.strike(str(out).encode(), at, code)
    try:
        main()
    except SystemExit as ended:
        return ended.code, (place / "said").read_text(), shim.counted()

def generate_apart(*arguments):
    reader, writer = os.pipe()
    child = os.fork()
    if not child:
        os.write(writer, json.dumps(generate(*arguments)).encode())
        os._exit(0)
    os.close(writer)
    with os.fdopen(reader) as pipe:
        answer = pipe.read()
    status = os.waitpid(child, 0)[1]
    return json.loads(answer) if answer else (-os.WTERMSIG(status), "", 0)

def content(out):
    return {p.name: p.read_bytes() for p in out.iterdir() if p.name != ".lock"}

answer = os.dup(1)
status, said, count = generate(place / "whole")
whole, out, wrong = content(place / "whole"), place / "out", []
for at in range(count):
    for code in (errno.ENOSPC, 0):
        rmtree(out, ignore_errors=True)
        status, said, _ = generate_apart(out, at, code)
        lines = [line for line in said.splitlines() if not line.endswith(" s)")]
        left = [p.name for p in out.iterdir() if p.name.startswith(".") and p.name != ".lock"]
        if code:
            good = status == 1 and len(lines) == 1 and "cannot be written" in lines[0] and not left
        else:
            good = status == -9
        again, _, _ = generate_apart(out)
        there = content(out)
        if not good or again or there != whole:
            wrong.append([at, code, status, lines, left, again, sorted(set(whole.items()) ^ set(there.items()))])
os.write(answer, json.dumps({"count": count, "wrong": wrong}, default=str).encode())
"""


@pytest.mark.skipif(sys.platform != "linux" or not shutil.which("gcc"), reason="gcc and LD_PRELOAD are needed")
def test_whichever_write_of_a_corpus_fails_it_ends_in_one_line_and_goes_on_to_the_same_bytes(tmp_path):
    """Every write, sync and rename, once as the disk is full, and once as the process is killed."""
    (tmp_path / "strike.c").write_text(STRIKE)
    shim = tmp_path / "strike.so"
    subprocess.run(["gcc", "-shared", "-fPIC", "-o", shim, tmp_path / "strike.c", "-ldl"], check=True)
    arguments = [sys.executable, "-c", STRUCK, tmp_path]
    environment = os.environ | {"LD_PRELOAD": str(shim)}
    ended = subprocess.run(arguments, capture_output=True, text=True, timeout=300, env=environment)
    assert ended.stdout, ended.stderr + (tmp_path / "said").read_text()
    found = json.loads(ended.stdout)
    assert found["count"] >= 20 and found["wrong"] == []


@pytest.fixture
def without_dolfinx(tmp_path):
    """An environment in which no process can import FEniCSx."""
    for name in ("dolfinx", "basix", "ufl"):
        (tmp_path / "none" / name).mkdir(parents=True)
        text = f"raise ModuleNotFoundError(\"No module named '{name}'\", name={name!r})\n"
        (tmp_path / "none" / name / "__init__.py").write_text(text)
    return os.environ | {"PYTHONPATH": str(tmp_path / "none")}


def test_without_fenicsx_the_other_solvers_verify(without_dolfinx, tmp_path):
    arguments = ["bench", "verification", "--solver", "skfem", "--solver", "fenicsx"]
    arguments += ["two layers", "--out", tmp_path / "out"]
    ended = subprocess.run([*COMMAND, *arguments], capture_output=True, text=True, env=without_dolfinx)
    assert ended.returncode == 0
    said = re.findall(r"^SKIPPED \d+ of \d+: solver 'fenicsx' needs dolfinx.*$", ended.stdout, flags=re.MULTILINE)
    assert len(said) == 1 and "apt-get install python3-dolfinx" in said[0] and "conda" in said[0]
    assert ended.stdout.count(", skfem: ") == 4 and "MISS" not in ended.stdout


def test_the_bare_package_has_a_head_and_runs_a_trained_surrogate():
    """What `pip install` brings alone: no torch, no anny, no dolfinx."""
    code = (
        BARE
        + """
from softdeca.lhm import identities
from softdeca.surrogate import Surrogate
print(len(identities.Anny().mean.vertices))
try:
    Surrogate.load("no/such/file.npz")
except ValueError as error:
    print(error)
"""
    )
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert ended.returncode == 0, ended.stderr
    assert ended.stdout.splitlines()[0] == "4463" and "`softdeca train` makes it" in ended.stdout


def test_without_torch_what_trains_says_what_to_install(tmp_path):
    words = ["train", "corpus", "--out", tmp_path / "out"]
    ended = subprocess.run([sys.executable, "-c", BARE + MAIN, *words], capture_output=True, text=True)
    assert ended.returncode == 1 and not list(tmp_path.iterdir())
    (said,) = [line for line in ended.stderr.splitlines() if not line.endswith(" s)")]
    assert said.startswith("softdeca: error: training needs torch") and "softdeca[train]" in said


def test_two_ctrl_c_while_a_preview_is_drawn_leave_no_file_and_no_crash(tmp_path):
    """The second comes while the first is cleaned up after, among the calls of the library that draws."""
    arguments = [*COMMAND, "animate", "conversation:1", "--accuracy", "none", "--out", tmp_path / "out"]
    with subprocess.Popen(arguments, stderr=subprocess.PIPE, text=True, start_new_session=True) as process:
        for line in process.stderr:
            if line.startswith("preview"):
                break
        process.send_signal(signal.SIGINT)
        time.sleep(0.02)
        process.send_signal(signal.SIGINT)
        rest = process.stderr.read()
        process.wait(60)
    assert process.returncode in (130, -signal.SIGINT), "ended by another signal than Ctrl-C's"
    assert "interrupted" in rest and "Traceback" not in rest
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["take.vtkhdf"]


@pytest.mark.parametrize("closed", [">&-", "<&- >&- 2>&-"])
def test_a_stream_that_is_closed_takes_no_file_with_it(closed, tmp_path):
    """A file opened later would else get the stream's number, and messages would be written into it."""
    script = f"exec {closed}; exec {sys.executable} -c '{MAIN}' bench list"
    ended = subprocess.run(["bash", "-c", script], capture_output=True, text=True, timeout=120)
    assert ended.returncode == 0 and "Traceback" not in ended.stderr
    assert (">&-" in closed.replace("2>&-", "")) == (ended.stdout == "")


def test_a_reader_that_has_gone_and_a_full_disk_are_no_traceback():
    words = f"{sys.executable} -c '{MAIN}' bench list"
    gone = subprocess.run(["bash", "-c", f"{words} | true; exit ${{PIPESTATUS[0]}}"], capture_output=True, text=True)
    assert gone.stderr == "" and gone.returncode in (0, 1)
    full = subprocess.run(["bash", "-c", f"{words} > /dev/full"], capture_output=True, text=True)
    assert full.returncode == 1 and full.stderr == "softdeca: error: No space left on device\n"


def test_a_backend_of_matplotlib_that_is_not_installed_does_not_matter(monkeypatch):
    ended = run("bench", "list", env={**os.environ, "MPLBACKEND": "nonsense"})
    assert ended.returncode == 0 and ended.stderr == ""
    draw = "from softdeca.animation.plots import subplots; from softdeca.lhm import InputError\ntry:\n    subplots()\n"
    draw += "except InputError as error:\n    print(error)"
    ended = subprocess.run(
        [sys.executable, "-c", draw], capture_output=True, text=True, env={**os.environ, "MPLBACKEND": "nonsense"}
    )
    assert ended.stdout.startswith("MPLBACKEND=nonsense: Matplotlib has no such backend")


@pytest.mark.parametrize(
    ("name", "value"),
    [("OMP_NUM_THREADS", "abc"), ("NUMBA_NUM_THREADS", "0")],
)
def test_an_odd_count_of_threads_is_named_in_one_line(name, value, tmp_path, sphere_head):
    save_head(tmp_path / "head.npz", sphere_head)
    ended = run("head", "check", tmp_path / "head.npz", env={**os.environ, name: value})
    assert ended.stdout and ended.stderr.count("\n") == 1 and name in ended.stderr and "Traceback" not in ended.stderr


def test_a_machine_is_described_whatever_the_count_of_threads(monkeypatch):
    for value in ("abc", "", "0", "4,2"):
        monkeypatch.setenv("OMP_NUM_THREADS", value)
        assert describe_machine()["threads"] == "default"


def test_a_scheduler_that_does_not_answer_is_told_before_any_work(tmp_path, command, monkeypatch):
    from softdeca.surrogate.corpus import people, schedule

    monkeypatch.setattr(schedule, "PATIENCE", "1s")
    monkeypatch.setattr(people, "people_from_text", None)  # the work that comes first
    ended = command("corpus", "generate", "--scheduler", "tcp://127.0.0.1:1", "--out", tmp_path / "made")
    assert ended.status == 1, "one line: the work would have ended in a TypeError"
    with pytest.raises(InputError, match="tcp://127.0.0.1:1: no Dask scheduler answers"):
        schedule.check_scheduler(schedule.make_schedule(1, "tcp://127.0.0.1:1"))
    assert not (tmp_path / "made").exists()
