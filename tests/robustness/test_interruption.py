"""Ctrl-C, a full disk and missing packages: one line, the right exit status, and no file left half-written."""

import os
import re
import resource
import signal
import subprocess
import sys
import time

import h5py
import pytest

COMMAND = (sys.executable, "-c", "from softdeca.cli import main; main()")
WITHOUT_DOLFINX = """
import sys
class Refuse:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in ("dolfinx", "basix", "ufl"):
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
sys.meta_path.insert(0, Refuse())
from softdeca.cli import main
main()
"""
CORPUS = """
import sys
from softdeca.surrogate.corpus import Corpus
from softdeca.surrogate.plan import CorpusPlan
from softdeca.surrogate.sphere import Spheres
if __name__ == "__main__":
    space = Spheres(2)
    plan = CorpusPlan(identities=(60, 20), expressions=(40, 20), parameter_sets=(10, 10), frames=40)
    Corpus(sys.argv[1], plan, space).generate(
        space.fit, workers=2, on_progress=lambda what, share: print(what, file=sys.stderr, flush=True)
    )
"""
POOL = """
import sys, time
from softdeca.surrogate.pool import results_of
if __name__ == "__main__":
    print("begin", file=sys.stderr, flush=True)
    for _ in results_of(time.sleep, [0.01] * 5000, workers=2, name="pool"):
        print("done", file=sys.stderr, flush=True)
"""


def run(*arguments, **how):
    return subprocess.run([*COMMAND, *map(str, arguments)], capture_output=True, text=True, timeout=120, **how)


def interrupted(process, beginning):
    """Send the terminal's Ctrl-C once a line on stderr begins so; the rest of stderr, and the seconds it took."""
    for line in process.stderr:
        if line.startswith(beginning):
            break
    time.sleep(0.3)
    os.killpg(process.pid, signal.SIGINT)
    begin = time.monotonic()
    rest = process.stderr.read()
    process.wait(60)
    return rest, time.monotonic() - begin


def test_ctrl_c_ends_a_study_in_one_line(tmp_path):
    pytest.importorskip("dolfinx")
    arguments = [*COMMAND, "study", "--out", tmp_path / "study"]
    with subprocess.Popen(arguments, stderr=subprocess.PIPE, text=True, start_new_session=True) as process:
        rest, seconds = interrupted(process, "scenes")
    said = [line for line in rest.splitlines() if line and not line.endswith(" s)")]
    assert process.returncode == 130
    assert said == ["softdeca: interrupted; what was finished is kept and used by the next run"]
    assert [p.name for p in (tmp_path / "study").iterdir()] == [".lock"]
    assert seconds < 20


def test_ctrl_c_ends_the_workers_of_a_corpus_and_leaves_whole_shards(tmp_path):
    (tmp_path / "make.py").write_text(CORPUS)
    arguments = [sys.executable, tmp_path / "make.py", tmp_path / "corpus"]
    with subprocess.Popen(arguments, stderr=subprocess.PIPE, text=True, start_new_session=True) as process:
        rest, seconds = interrupted(process, "corpus: identity")
    assert process.returncode != 0 and rest.rstrip().endswith("KeyboardInterrupt") and rest.count("Traceback") == 1
    assert seconds < 20
    left = sorted(p.name for p in (tmp_path / "corpus").iterdir())
    assert left[0] == "corpus.json" and 1 < len(left) < 60
    for name in left[1:]:
        assert name.startswith("identity-")
        with h5py.File(tmp_path / "corpus" / name) as shard:
            assert shard.keys()


@pytest.mark.parametrize("moment", ["begin", "done"])
def test_ctrl_c_ends_a_pool_whose_workers_start_or_run(moment, tmp_path):
    (tmp_path / "pool.py").write_text(POOL)
    arguments = [sys.executable, tmp_path / "pool.py"]
    with subprocess.Popen(arguments, stderr=subprocess.PIPE, text=True, start_new_session=True) as process:
        rest, seconds = interrupted(process, moment)
    said = rest.replace("done\n", "")
    assert process.returncode != 0 and said.rstrip().endswith("KeyboardInterrupt") and said.count("Traceback") == 1
    assert seconds < 20, "stderr ends with the last process that holds it"


def test_a_full_disk_is_named_and_leaves_nothing(tmp_path):
    def small_files():
        resource.setrlimit(resource.RLIMIT_FSIZE, (50_000, 50_000))

    ended = run("head", "fit", "--out", tmp_path / "head.npz", preexec_fn=small_files)
    said = [line for line in ended.stderr.splitlines() if not line.endswith(" s)")]
    assert ended.returncode == 1 and len(said) == 1
    assert said[0].startswith(f"softdeca: error: {tmp_path / 'head.npz'}: cannot be written")
    assert list(tmp_path.iterdir()) == []


def test_a_corpus_on_a_full_disk_keeps_whole_shards_only(tmp_path):
    (tmp_path / "make.py").write_text(CORPUS)
    arguments = ["bash", "-c", f"ulimit -f 20; exec {sys.executable} {tmp_path}/make.py {tmp_path}/corpus"]
    ended = subprocess.run(arguments, capture_output=True, text=True, timeout=120)
    last = ended.stderr.rstrip().splitlines()[-1]
    assert ended.returncode == 1 and re.search(r"InputError: .*identity-\d+\.h5: cannot be written \(File too", last)
    assert [p.name for p in (tmp_path / "corpus").iterdir()] == ["corpus.json"]


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="no /dev/full on this system")
def test_results_that_cannot_be_printed_are_an_error():
    with open("/dev/full", "w") as full:
        ended = subprocess.run([*COMMAND, "--help"], stdout=full, stderr=subprocess.PIPE, text=True, timeout=60)
    assert ended.returncode != 0
    assert ended.stderr.splitlines() == ["softdeca: error: No space left on device"]


def test_without_fenicsx_one_line_says_what_to_install():
    arguments = ["bench", "verification", "--solver", "fenicsx"]
    ended = subprocess.run([sys.executable, "-c", WITHOUT_DOLFINX, *arguments], capture_output=True, text=True)
    said = [line for line in ended.stderr.splitlines() if not line.endswith(" s)")]
    assert ended.returncode == 1 and len(said) == 1
    assert said[0].startswith("softdeca: error: solver 'fenicsx' needs dolfinx")
    assert "apt-get install python3-dolfinx" in said[0] and "conda" in said[0]


def test_without_fenicsx_the_other_solvers_verify():
    arguments = ["bench", "verification", "--solver", "skfem", "--solver", "fenicsx"]
    ended = subprocess.run([sys.executable, "-c", WITHOUT_DOLFINX, *arguments], capture_output=True, text=True)
    assert ended.returncode == 0
    assert "softdeca: fenicsx is not installed: left out" in ended.stderr.splitlines()
    assert ended.stdout.count("skfem") > 20 and "OUT" not in ended.stdout
