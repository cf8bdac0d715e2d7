"""Sphinx' settings: pages in MyST and as programs, run when they are built; no page needs a network."""

import re
import sys
import zlib
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

project = "softdeca"
author = "The softdeca authors"
copyright = author
root = Path(__file__).resolve().parent
out = root.parent / "out" / "docs"

extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.intersphinx",
    "sphinx_click",
]
nb_custom_formats = {".py": ["jupytext.reads", {"fmt": "py:percent"}]}
nb_execution_mode = "force"
nb_execution_raise_on_error = True
nb_execution_timeout = 300
nb_output_stderr = "remove"
nb_merge_streams = True
myst_enable_extensions = ["colon_fence", "deflist"]
myst_heading_anchors = 3
exclude_patterns = [
    "conf.py",
    "figures.py",
    "tutorials/gent.py",
    "tutorials/quasi_newton.py",
    "tutorials/stopped_early.py",
]

html_theme = "pydata_sphinx_theme"
html_title = "softdeca"
html_copy_source = False
html_static_path = ["static"]
html_css_files = ["pages.css"]
html_sidebars = dict.fromkeys(
    (
        "index",
        "concepts",
        "glossary",
        "surrogate",
        "paper",
        "bounds",
        "limits",
        "python",
        "own-head",
        "viewer",
        "corpus",
        "parallel",
        "studies",
        "arena",
        "architecture",
        "extend",
        "upstream",
    ),
    [],
)
html_theme_options = {
    "show_prev_next": True,
    "navbar_align": "left",
    "secondary_sidebar_items": ["page-toc"],
}
html_context = {"default_mode": "light"}

autodoc_default_options = {"members": True, "member-order": "groupwise"}
add_module_names = False
python_use_unqualified_type_names = True
autodoc_typehints_format = "fully-qualified"
autodoc_class_signature = "mixed"
autodoc_type_aliases = {
    name: name for name in ("Floats", "Floats32", "Ints", "Surface")
}
python_maximum_signature_line_length = 88

OTHERS = {
    "python": (
        "https://docs.python.org/3",
        {
            "py:class pathlib.Path": "library/pathlib.html#pathlib.Path",
            "py:class os.PathLike": "library/os.html#os.PathLike",
            "py:class collections.abc.Callable": "library/collections.abc.html#collections.abc.Callable",
            "py:class collections.abc.Collection": "library/collections.abc.html#collections.abc.Collection",
            "py:class collections.abc.Mapping": "library/collections.abc.html#collections.abc.Mapping",
            "py:class collections.abc.Sequence": "library/collections.abc.html#collections.abc.Sequence",
            "py:class bool": "library/functions.html#bool",
            "py:class bytes": "library/stdtypes.html#bytes",
            "py:class dict": "library/stdtypes.html#dict",
            "py:class float": "library/functions.html#float",
            "py:class int": "library/functions.html#int",
            "py:class list": "library/stdtypes.html#list",
            "py:class str": "library/stdtypes.html#str",
            "py:class tuple": "library/stdtypes.html#tuple",
            "py:data typing.Any": "library/typing.html#typing.Any",
            "py:data typing.Literal": "library/typing.html#typing.Literal",
            "py:exception ValueError": "library/exceptions.html#ValueError",
        },
    ),
    "numpy": (
        "https://numpy.org/doc/stable",
        {
            "py:class numpy.ndarray": "reference/generated/numpy.ndarray.html",
            "py:class numpy.random.Generator": "reference/random/generator.html#numpy.random.Generator",
        },
    ),
    "scipy": (
        "https://docs.scipy.org/doc/scipy",
        {
            "py:class scipy.sparse.csr_matrix": "reference/generated/scipy.sparse.csr_matrix.html"
        },
    ),
}
"""Names of other projects that pages point to: kept here, since their own lists would be fetched at each build."""


def _inventory(name: str, places: dict[str, str]) -> str:
    """The file of names that intersphinx reads, in its version 2."""
    head = f"# Sphinx inventory version 2\n# Project: {name}\n# Version: \n"
    head += "# The remainder of this file is compressed using zlib.\n"
    lines = (
        f"{what.split()[1]} {what.split()[0]} 1 {place} -\n"
        for what, place in places.items()
    )
    file = out.parent / "inventories" / f"{name}.inv"
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_bytes(head.encode() + zlib.compress("".join(lines).encode()))
    return str(file)


intersphinx_mapping = {
    name: (address, _inventory(name, places))
    for name, (address, places) in OTHERS.items()
}


def _plain(app, what, name, obj, options, lines):
    """Docstrings are plain words and formulas: what reStructuredText would take for markup is none, but `code` is."""
    for number, line in enumerate(lines):
        parts = re.split(r"(`[^`]+`)", line)
        lines[number] = "".join(
            f"`{part}`" if part.startswith("`") else re.sub(r"([|*_\\])", r"\\\1", part)
            for part in parts
        )


def _plain_command(app, ctx, lines):
    """The same for the help of commands; directives and fields among their lines stay."""
    for number, line in enumerate(lines):
        if not line.lstrip().startswith((".. ", ":")):
            plain = [line]
            _plain(app, "", "", None, None, plain)
            lines[number] = plain[0]


def _by_alias(app, what, name, obj, options, signature, returned):
    """Names of arrays as they are written, also beside None."""
    return tuple(
        text and re.sub(r"TypeAliasForwardRef\('(\w+)'\)", r"\1", text)
        for text in (signature, returned)
    )


def setup(app):
    """Let docstrings pass `_plain` and signatures `_by_alias`."""
    app.connect("autodoc-process-docstring", _plain)
    for part in ("description", "options", "arguments", "epilog"):
        app.connect(f"sphinx-click-process-{part}", _plain_command)
    app.connect("autodoc-process-signature", _by_alias)
