"""Made-up head motion: yaw, pitch and roll of somebody who talks and listens, for takes that have none recorded.

Posture drifts over seconds, and on it small beats follow one another as syllables stressed or nods do. Both are
noise through low passes, so that the angular acceleration is continuous as that of a real head: what shakes flesh
is an acceleration. The figures are chosen by us.
"""

from __future__ import annotations

import numpy as np
from scipy.signal import lfilter

from ..base.errors import InputError
from ..base.mesh import Floats
from .take import check_rate

POSTURE = np.radians([7.0, 4.0, 3.0])
"""Standard deviations of yaw, pitch and roll [rad], and those of the beats."""
BEATS = np.radians([1.2, 2.0, 0.8])
SLOW, QUICK = 0.5, 0.07
"""Time constants [s] of posture and of beats."""
PASSES = 4


def head_motion(rng: np.random.Generator, frames: int, *, rate: float = 60.0) -> Floats:
    """Yaw, pitch and roll [rad] (see `head_rotation`) about straight ahead, shape (frames, 3), `rate` [Hz].

    The same generator state gives the same angles. Raises InputError for fewer than one frame and a rate that is not
    positive.
    """
    if frames < 1:
        raise InputError(f"frames: {frames}, expected 1 or more")
    check_rate(rate)
    return _swayed(rng, frames, SLOW * rate) * POSTURE + _swayed(rng, frames, QUICK * rate) * BEATS


def _swayed(rng: np.random.Generator, frames: int, constant: float) -> Floats:
    """Noise through equal low passes of a time constant in frames: variance 1 from the first on, shape (frames, 3)."""
    pole = float(np.exp(-1.0 / constant))
    poles = np.poly([pole] * PASSES)
    ahead = int(np.ceil(15.0 * constant)) + 1
    answer = lfilter([1.0], poles, np.eye(1, ahead)[0])
    noise = rng.standard_normal((ahead + frames, 3))
    return lfilter([1.0], poles, noise, axis=0)[ahead:] / np.linalg.norm(answer)
