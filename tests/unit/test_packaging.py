"""The house: packages that are listed are there, imports go the right way, and light imports stay light."""

import ast
import subprocess
import sys
from pathlib import Path

import grimp
import numpy as np
import pytest
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components

from softdeca.lhm.base.files.text import read_toml

ROOT = Path(__file__).resolve().parents[2]
PORTIONS = ("lhm", "reference", "surrogate", "animation", "benchmarks", "cli")


def test_listed_packages_are_those_on_disk():
    lines = (ROOT / "pyproject.toml").read_text().split("packages = [")[1].split("]")[0].splitlines()
    listed = {line.strip(' ",').removeprefix("softdeca.").replace(".", "/") for line in lines if line.strip()}
    on_disk = {
        str(init.parent.relative_to(ROOT)) for portion in PORTIONS for init in (ROOT / portion).rglob("__init__.py")
    }
    assert listed == on_disk


def imported(*folders):
    """The first part of each name that is imported absolutely, by file."""
    for path in [path for folder in folders for path in sorted((ROOT / folder).rglob("*.py"))]:
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import):
                yield from ((path, alias.name.split(".")[0]) for alias in node.names)
            elif isinstance(node, ast.ImportFrom) and node.level == 0:
                yield path, node.module.split(".")[0]


def test_each_package_imported_is_a_dependency():
    """What another package happens to bring along may go with its next release."""
    listed = (ROOT / "pyproject.toml").read_text().split("\ndependencies = [")[1].split("]")[0]
    listed = {line.strip(' ",').split(">=")[0].replace("-", "_") for line in listed.splitlines() if ">=" in line}
    other_names = {"PIL": "pillow", "skfem": "scikit_fem"}
    names = {name for _, name in imported(*PORTIONS)} - set(sys.stdlib_module_names)
    # FEniCSx comes from Debian or conda; extras: what trains, MP4, libigl, FElupe, gmsh, speech, Draco, CHOLMOD, USD.
    elsewhere = {"dolfinx", "basix", "ufl", "mpi4py", "petsc4py"}
    elsewhere |= {"torch", "imageio_ffmpeg", "igl", "felupe", "gmsh", "openfacefx", "DracoPy", "sksparse", "pxr"}
    # The live page; contact's check; the arena's solvers, some in environments of their own, with what they share.
    elsewhere |= {"websockets", "ipctk", "pyamg", "newton", "warp", "mujoco", "torchfem", "sfepy", "jax", "jax_fem"}
    assert {other_names.get(name, name) for name in names} - elsewhere == listed


def test_no_module_is_imported_by_its_folder():
    """`import reference` from the root would make a second copy of each module."""
    assert [path for path, name in imported(*PORTIONS, "tests") if name in PORTIONS] == []


def test_the_default_head_and_all_listed_data_are_part_of_the_package():
    data = read_toml(ROOT / "pyproject.toml")["tool"]["setuptools"]["package-data"]
    assert {"anny.npz", "anny_within.npz"} <= set(data["softdeca.lhm.identities"])
    for package, names in data.items():
        folder = ROOT / package.removeprefix("softdeca.").replace(".", "/")
        assert all(list(folder.glob(name)) for name in names), package


@pytest.mark.parametrize("module", ["softdeca.cli", "softdeca.surrogate"])
def test_light_imports_load_no_heavy_package(module):
    code = (
        f"import sys, {module}; heavy = {{'torch', 'dolfinx', 'matplotlib', 'pyvista'}} & set(sys.modules);"
        "sys.exit(' '.join(heavy) or 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_no_modules_import_one_another():
    """Imports inside functions count, too; those for type checkers alone do not."""
    graph = grimp.build_graph(*(f"softdeca.{name}" for name in PORTIONS), exclude_type_checking_imports=True)
    modules = sorted(graph.modules)
    number = {module: k for k, module in enumerate(modules)}
    pairs = [(number[m], number[n]) for m in modules for n in graph.find_modules_directly_imported_by(m)]
    assert len(modules) > 300 and len(pairs) > 1000
    rows, columns = np.array(pairs).T
    joined = csr_matrix((np.ones(len(rows)), (rows, columns)), shape=(len(modules),) * 2)
    count, circle = connected_components(joined, connection="strong")
    circles = [[m for m, which in zip(modules, circle, strict=True) if which == k] for k in range(count)]
    assert [each for each in circles if len(each) > 1] == []
