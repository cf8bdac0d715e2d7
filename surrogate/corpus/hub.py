"""A corpus as Hugging Face `datasets`, every parameter by its name; it needs the extra `hub`."""

from __future__ import annotations

from collections.abc import Iterator
from os import PathLike
from typing import TYPE_CHECKING, Any

import numpy as np

from ...lhm.base.errors import MissingDependencyError
from .mixture import INFOS
from .plan import SPLITS
from .reading import Table

if TYPE_CHECKING:
    import datasets


def to_datasets(folder: str | PathLike[str]) -> datasets.DatasetDict:
    """Return the accepted static frames of a corpus as `datasets` by split, "train" and "test".

    A row has `person`, `kind` of p, `recording`, `weights` (52,), `blendshapes` S and `simulated` T [mm], both (n, 3),
    and each parameter of p by its name, in its unit: without its waves where it `varies` over the face. Rows go through
    the cache of `datasets`, once. Raises InputError as `Table`, MissingDependencyError without the package.
    """
    try:
        from datasets import Array2D, Dataset, DatasetDict, Features, Sequence, Value
    except ModuleNotFoundError:
        raise MissingDependencyError("needs the package datasets: pip install 'softdeca[hub]'") from None
    shape = Table(folder, "statics", "train").mean.vertices.shape
    features = Features(
        {
            "person": Value("int32"),
            "kind": Value("string"),
            "recording": Value("string"),
            "weights": Sequence(Value("float32"), length=52),
            "blendshapes": Array2D(shape, "float32"),
            "simulated": Array2D(shape, "float32"),
            "varies": Value("bool"),
            **{name: Value("float32") for name in INFOS},
        }
    )

    def convert(split: str) -> datasets.Dataset:
        how = {"folder": str(folder), "split": split}
        return Dataset.from_generator(list_rows, features=features, gen_kwargs=how, split=split)

    return DatasetDict({split: convert(split) for split in SPLITS})


def list_rows(folder: str, split: str) -> Iterator[dict[str, Any]]:
    """Give the rows of a split as `to_datasets` has them."""
    table = Table(folder, "statics", split)  # type: ignore[arg-type]  # one of SPLITS
    for number in range(len(table)):
        row, given = table[number], table.parameters(number)
        shapes = table.shapes(row["identity"])
        blended = table.skin(row["identity"]).vertices + np.tensordot(row["weights"], shapes, axes=1)
        yield {
            "person": int(row["identity"]),
            "kind": given.kind,
            "recording": row["recording"].decode(),
            "weights": row["weights"],
            "blendshapes": blended.astype(np.float32),
            "simulated": (blended + row["corrected"]).astype(np.float32),
            "varies": not given.uniform,
            **{name: given.level(name) for name in INFOS},
        }
