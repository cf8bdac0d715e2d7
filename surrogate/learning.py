"""torch, which training needs and the run time does not, and the state of a training in a file."""

from __future__ import annotations

import io
from os import PathLike
from pathlib import Path
from typing import Any

from ..lhm.base.errors import InputError, MissingDependencyError
from ..lhm.base.files.atomic import write_whole

try:
    import torch
    from torch import nn
    from torch.nn.functional import elu
except ImportError as error:
    raise MissingDependencyError(f"training needs torch ({error}): pip install 'softdeca[train]'") from None

__all__ = ["elu", "keep_state", "kept_state", "nn", "torch"]


def keep_state(path: str | PathLike[str], state: dict[str, Any]) -> None:
    """Write a training's state, whole or not at all; `state["of"]` says of which training it is."""
    buffer = io.BytesIO()
    torch.save(state, buffer)
    write_whole(Path(path), buffer.getvalue())


def kept_state(path: str | PathLike[str], of: Any) -> dict[str, Any]:
    """What `keep_state` wrote; InputError for a damaged file, and for one of another training than `of`."""
    try:
        state: dict[str, Any] = torch.load(path, weights_only=True)
        same = state["of"] == of
    except Exception as error:
        raise InputError(f"{path}: damaged, or no state of a training ({type(error).__name__})") from None
    if not same:
        raise InputError(f"{path}: of another training (config or corpus); remove it, or name another file")
    return state
