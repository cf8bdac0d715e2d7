"""The wheel beside no FEniCSx: the example of docs/python.md runs, and a head is fitted, animated and shown."""

import hashlib
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import venv
from pathlib import Path
from urllib.request import urlopen

import pytest

from softdeca.lhm.expressions import ARKIT

ROOT = Path(__file__).resolve().parents[2]
PORTIONS = ("lhm", "reference", "surrogate", "animation", "benchmarks", "cli")
ENVIRONMENT = ROOT / "build" / "wheel"
"""It takes a gigabyte, so it is kept until the listed packages change."""
HOST = {name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "VIRTUAL_ENV")}


def run(*command, folder):
    """Run a command of the environment and return its output."""
    program, *words = command
    done = subprocess.run([ENVIRONMENT / "bin" / program, *words], cwd=folder, env=HOST, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture
def installed(tmp_path):
    """Install the wheel as a newcomer would; an empty folder to work in."""
    source, folder = tmp_path / "source", tmp_path / "work"
    for portion in PORTIONS:
        shutil.copytree(ROOT / portion, source / portion, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, source)
    build = ("wheel", "--quiet", "--no-deps", "--no-build-isolation", "--wheel-dir", tmp_path, source)
    subprocess.run([sys.executable, "-m", "pip", *build], check=True)
    (wheel,) = tmp_path.glob("*.whl")
    listed = (ROOT / "pyproject.toml").read_bytes() + (ROOT / "constraints.txt").read_bytes()
    stamp, wanted = ENVIRONMENT / "packages", hashlib.sha256(listed).hexdigest()
    if not stamp.exists() or stamp.read_text() != wanted:
        venv.create(ENVIRONMENT, clear=True, with_pip=True)
    run("pip", "uninstall", "--yes", "softdeca", folder=tmp_path)
    run("pip", "install", "-c", ROOT / "constraints.txt", f"{wheel}[view]", folder=tmp_path)
    stamp.write_text(wanted)
    folder.mkdir()
    return folder


@pytest.mark.timeout(1800)  # pip may have to download a gigabyte
def test_the_wheel_alone_solves_fits_animates_and_shows(installed):
    example, *_ = re.findall(r"```python\n(.*?)```", (ROOT / "docs" / "python.md").read_text(), flags=re.DOTALL)
    example = example.replace("load_template()", "load_template(level=1)").replace('"fenicsx"', '"skfem"')
    absent = "import importlib.util\nassert importlib.util.find_spec('dolfinx') is None\n"
    printed = run("python", "-c", absent + example, folder=installed)
    same, law = (float(away) for away in re.findall(r"at most (\S+) mm away", printed))
    assert same < 0.01 < law

    run("softdeca", "head", "fit", "--seed", "3", "--level", "1", "--out", "head.npz", folder=installed)
    lines = [["Timecode", "BlendShapeCount", *(name[0].upper() + name[1:] for name in ARKIT)]]
    for frame in range(3):
        opened = [0.2 * frame if name == "jawOpen" else 0.0 for name in ARKIT]
        lines.append([f"10:00:00:{frame:02d}.250", 61, *opened])
    (installed / "take.csv").write_text("\n".join(",".join(map(str, line)) for line in lines) + "\n")
    options = ("--accuracy", "0.05", "--preview", "none", "--out", "take")
    run("softdeca", "animate", "take.csv", "--head", "head.npz", *options, folder=installed)
    log = [json.loads(line) for line in (installed / "take" / "log.jsonl").read_text().splitlines()]
    assert len(log) == 3 and max(frame["error"] for frame in log) <= 0.05

    command = [ENVIRONMENT / "bin" / "softdeca", "view", "head.npz"]
    server = subprocess.Popen(command, cwd=installed, env=HOST, stdout=subprocess.PIPE, text=True)
    try:
        with urlopen(re.search(r"http://\S+", server.stdout.readline())[0], timeout=60) as answer:
            assert answer.status == 200 and b"jawOpen" in answer.read()
    finally:
        server.send_signal(signal.SIGINT)
        assert server.wait(60) == 0
        server.stdout.close()
