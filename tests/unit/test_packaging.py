"""The house: packages that are listed are there, imports go the right way, and light imports stay light."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PORTIONS = ("lhm", "reference", "surrogate", "animation", "benchmarks", "cli")


def test_listed_packages_are_those_on_disk():
    lines = (ROOT / "pyproject.toml").read_text().split("packages = [")[1].split("]")[0].splitlines()
    listed = {line.strip(' ",').removeprefix("softdeca.").replace(".", "/") for line in lines if line.strip()}
    on_disk = {
        str(init.parent.relative_to(ROOT)) for portion in PORTIONS for init in (ROOT / portion).rglob("__init__.py")
    }
    assert listed == on_disk


def test_each_package_imported_is_a_dependency():
    """What another package happens to bring along may go with its next release."""
    listed = (ROOT / "pyproject.toml").read_text().split("\ndependencies = [")[1].split("]")[0]
    listed = {line.strip(' ",').split(">=")[0].replace("-", "_") for line in listed.splitlines() if ">=" in line}
    imported = set()
    for path in [p for portion in PORTIONS for p in (ROOT / portion).rglob("*.py")]:
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import):
                imported |= {alias.name.split(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
                imported.add(node.module.split(".")[0])
    other_names = {"PIL": "pillow", "skfem": "scikit_fem"}
    needed = {other_names.get(name, name) for name in imported - set(sys.stdlib_module_names)}
    # FEniCSx comes from Debian or conda; what trains, MP4, Draco, CHOLMOD, libigl, FElupe, gmsh and speech are extras.
    elsewhere = {"dolfinx", "basix", "ufl", "mpi4py", "petsc4py", "slepc4py"}
    elsewhere |= {"torch", "imageio_ffmpeg", "igl", "felupe", "gmsh", "openfacefx", "DracoPy", "sksparse"}
    assert needed - elsewhere == listed


@pytest.mark.parametrize("path", [p for d in (*PORTIONS, "tests") for p in sorted((ROOT / d).rglob("*.py"))], ids=str)
def test_no_module_is_imported_by_its_folder(path):
    """`import reference` from the root would make a second copy of each module."""
    for node in ast.walk(ast.parse(path.read_text())):
        names = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            names = [node.module or ""]
        assert not [n for n in names if n.split(".")[0] in PORTIONS], path


def test_the_default_head_is_part_of_the_package():
    lines = (ROOT / "pyproject.toml").read_text().split("package-data]")[1].splitlines()[1:5]
    assert '"softdeca.lhm.identities" = ["anny.npz", "anny_within.npz"]' in lines
    assert all((ROOT / "lhm" / "identities" / name).is_file() for name in ("anny.npz", "anny_within.npz"))


@pytest.mark.parametrize("module", ["softdeca.lhm", "softdeca.reference", "softdeca.cli", "softdeca.surrogate"])
def test_light_imports_load_no_heavy_package(module):
    code = (
        f"import sys, {module}; heavy = {{'torch', 'dolfinx', 'matplotlib', 'pyvista'}} & set(sys.modules);"
        "sys.exit(' '.join(heavy) or 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
