"""Corpora as torch datasets: static frames, sequences, derivatives. Each reader opens files as it needs them."""

from __future__ import annotations

from os import PathLike

import numpy as np
import torch
from torch.utils.data import Dataset

from .plan import Split
from .reading import Row, Table


class CorpusDataset(Dataset):
    """The accepted rows of a table of a corpus as tensors; see `reading.Table` for names, shapes and errors.

    Texts are left out; T - S stays float16. For loaders with several workers: nothing is open between two rows.
    `partial`: of a corpus that is not complete, what is there.
    """

    def __init__(self, folder: str | PathLike[str], split: Split, *, table: str = "statics", partial: bool = False):
        self.table = Table(folder, table, split, partial=partial)

    def __len__(self) -> int:
        return len(self.table)

    def __getitem__(self, index: int) -> dict[str, torch.Tensor]:
        if not -len(self) <= index < len(self):
            raise IndexError(index)
        return _tensors(self.table[index])


def _tensors(row: Row) -> dict[str, torch.Tensor]:
    return {name: torch.as_tensor(np.asarray(value)) for name, value in row.items() if value.dtype.kind != "S"}
