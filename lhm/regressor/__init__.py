"""The regressor D: how deep the skull wrap lies under a skin wrap (SoftDECA 3.1.2), learned from pairs or a prior."""

from .depths import DepthPairs, DepthRegressor
from .evaluation import DepthErrors, LeaveOneOut, leave_one_out
from .files import PairReport, read_pairs
from .measured import MeasuredDepths, inward_normals, measured_depths, moved_wrap
from .prior import default_regressor, prior_pairs

__all__ = [
    "DepthErrors",
    "DepthPairs",
    "DepthRegressor",
    "LeaveOneOut",
    "MeasuredDepths",
    "PairReport",
    "default_regressor",
    "inward_normals",
    "leave_one_out",
    "measured_depths",
    "moved_wrap",
    "prior_pairs",
    "read_pairs",
]
