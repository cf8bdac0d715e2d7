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


def test_no_module_is_imported_by_its_folder():
    """`import reference` from the root would make a second copy of each module."""
    assert [path for path, name in imported(*PORTIONS, "tests") if name in PORTIONS] == []


@pytest.mark.parametrize("module", ["softdeca.cli", "softdeca.surrogate"])
def test_light_imports_load_no_heavy_package(module):
    code = (
        f"import sys, {module}; heavy = {{'torch', 'dolfinx', 'matplotlib', 'pyvista', 'trimesh'}} & set(sys.modules);"
        "sys.exit(' '.join(heavy) or 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_no_modules_import_one_another():
    """Imports inside functions count, too, and those for type checkers alone."""
    graph = grimp.build_graph(*(f"softdeca.{name}" for name in PORTIONS))
    modules = sorted(graph.modules)
    number = {module: k for k, module in enumerate(modules)}
    pairs = [(number[m], number[n]) for m in modules for n in graph.find_modules_directly_imported_by(m)]
    assert len(modules) > 300 and len(pairs) > 1000
    rows, columns = np.array(pairs).T
    joined = csr_matrix((np.ones(len(rows)), (rows, columns)), shape=(len(modules),) * 2)
    count, circle = connected_components(joined, connection="strong")
    circles = [[m for m, which in zip(modules, circle, strict=True) if which == k] for k in range(count)]
    assert [each for each in circles if len(each) > 1] == []
