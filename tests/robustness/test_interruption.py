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
import time

import h5py
import pytest

from softdeca.lhm.base.progress import silent
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
responses = 0.0
random = 4
sources = { random = 1.0 }
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


def test_ctrl_c_that_meets_a_del_is_not_lost(tmp_path):
    """Python ignores what a `__del__` raises, and a run of minutes went on to its end."""
    program = """
import os, signal, time
from softdeca.cli import app

class Slow:
    def __del__(self):
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(5)

def work(*_, **__):
    Slow()
    time.sleep(60)

app.app.main = work
app.main()
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=30)
    assert done.returncode == 130 and done.stderr.startswith("softdeca: interrupted"), done.stderr


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
options = ['preset = "tiny"', "identities = 2", "frames = 1", "run = 3", "responses = 0.0"]
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
    assert found["count"] >= 15 and found["wrong"] == []


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
    """`pip install` alone brings no torch, no anny, no dolfinx."""
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


def test_a_reader_that_has_gone_and_a_full_disk_are_no_traceback():
    words = f"{sys.executable} -c '{MAIN}' bench list"
    gone = subprocess.run(["bash", "-c", f"{words} | true; exit ${{PIPESTATUS[0]}}"], capture_output=True, text=True)
    assert gone.stderr == "" and gone.returncode in (0, 1)
    full = subprocess.run(["bash", "-c", f"{words} > /dev/full"], capture_output=True, text=True)
    assert full.returncode == 1 and full.stderr == "softdeca: error: No space left on device\n"
