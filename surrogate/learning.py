"""torch, which training needs and the run time does not; where it is missing one line says so."""

from ..lhm.errors import MissingDependencyError

try:
    import torch
    from torch import nn
    from torch.nn.functional import elu
except ImportError as error:
    raise MissingDependencyError(f"training needs torch ({error}): pip install 'softdeca[train]'") from None

__all__ = ["elu", "nn", "torch"]
