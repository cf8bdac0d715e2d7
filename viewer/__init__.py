"""A head in 3D on one page, for any browser, from a local file."""

from .face import face_page
from .page import Layer, Pose, Rig, page

__all__ = ["Layer", "Pose", "Rig", "face_page", "page"]
