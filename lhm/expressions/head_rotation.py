"""How a head is turned: yaw about y, pitch about x, roll about z [rad], R = Ry(yaw) Rx(pitch) Rz(roll).

Axes as everywhere: x to the subject's left, y up, z forward. Positive yaw turns the face to the subject's left,
positive pitch downward, positive roll tilts it towards the subject's right shoulder. R takes the head's own frame to
the room's.
"""

from __future__ import annotations

import numpy as np

from ..base.mesh import Floats


def rotations(angles) -> Floats:
    """Rotation matrices, shape (frames, 3, 3), of yaw, pitch and roll [rad], shape (frames, 3)."""
    values = np.asarray(angles, dtype=np.float64)
    (sy, sp, sr), (cy, cp, cr) = np.sin(values.T), np.cos(values.T)
    rows = (
        (cy * cr + sy * sp * sr, sy * sp * cr - cy * sr, sy * cp),
        (cp * sr, cp * cr, -sp),
        (cy * sp * sr - sy * cr, sy * sr + cy * sp * cr, cy * cp),
    )
    return np.moveaxis(np.array(rows), 2, 0)


def angles_of(matrices) -> Floats:
    """Yaw, pitch and roll [rad], shape (frames, 3), of rotation matrices; each without jumps from frame to frame."""
    r = np.asarray(matrices, dtype=np.float64)
    yaw, roll = np.arctan2(r[:, 0, 2], r[:, 2, 2]), np.arctan2(r[:, 1, 0], r[:, 1, 1])
    return np.unwrap(np.stack([yaw, np.arcsin(np.clip(-r[:, 1, 2], -1.0, 1.0)), roll], axis=1), axis=0)


def of_quaternions(quaternions) -> Floats:
    """Rotation matrices, shape (frames, 3, 3), of quaternions (x, y, z, w), shape (frames, 4), of any length but 0."""
    q = np.asarray(quaternions, dtype=np.float64)
    x, y, z, w = (q / np.linalg.norm(q, axis=1, keepdims=True)).T
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)),
        (2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)),
        (2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)),
    )
    return np.moveaxis(np.array(rows), 2, 0)
