"""A template in a file that users name."""

from __future__ import annotations

import os
from dataclasses import replace

from ..base.files.pack import load_packed, save_packed
from .template import Template

FORMAT = "softdeca template 2"


def save_template(path: str | os.PathLike[str], template: Template) -> None:
    """Write a template to a .npz file, whole or not at all, without its regressor and its space."""
    save_packed(path, FORMAT, replace(template, regressor=None, space=None))


def read_template(path: str | os.PathLike[str]) -> Template:
    """Read a template; InputError names a file that is missing, damaged, of another version or something else."""
    again = "make the template again by `softdeca head template`"
    return load_packed(path, FORMAT, Template, what="a template", else_do=again)
