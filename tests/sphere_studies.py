"""Studies of a layered sphere in place of a head, for processes that import them: tests put this folder on the path."""

from dataclasses import dataclass, replace
from functools import lru_cache
from types import SimpleNamespace

import numpy as np
from conftest import layered_sphere, with_regions

from softdeca.benchmarks.face.problems import body_of
from softdeca.benchmarks.studies.agreement.study import Agreement
from softdeca.benchmarks.studies.arena.study import WorkPrecision
from softdeca.benchmarks.studies.mesh.face import FaceBenchmark, nested_bodies
from softdeca.benchmarks.studies.mesh.study import MeshError
from softdeca.benchmarks.studies.person import Person
from softdeca.benchmarks.studies.scaling.minimal import Minimal
from softdeca.benchmarks.studies.scaling.ranks import Ranks
from softdeca.benchmarks.studies.scaling.throughput import Throughput
from softdeca.benchmarks.studies.scaling.unknowns import Unknowns
from softdeca.lhm import expressions


class Sphere(Person):
    """A sphere whose expressions draw its front out by 3 mm a weight."""

    def blend(self, weights):
        skin = self.head.skin.vertices
        front = np.maximum(skin[:, 2:] / np.abs(skin).max(), 0.0) * np.array([0.0, 0.3, 1.0])
        return skin + 3.0 * np.sum(weights, axis=1)[:, None, None] * front

    def shape(self, text):
        return self.blend(expressions.parse_weights(text)[None])[0]

    @property
    def shapes(self):
        return self.blend(np.eye(52)) - self.head.skin.vertices


@lru_cache
def sphere(level):
    head = layered_sphere(level)
    space = SimpleNamespace(name="spheres", mean=head.skin)
    return Sphere(space, np.zeros(3), with_regions(head) if level > 2 else head)


class OfSphere:
    alone = False  # a process for all of a study, as loading costs more than spheres

    def person(self, level=None, seed=None):
        return sphere(level or self.level)


@dataclass(frozen=True)
class SphereUnknowns(OfSphere, Unknowns):
    pass


@dataclass(frozen=True)
class SphereMinimal(OfSphere, Minimal):
    # A sphere has no flesh that hangs.
    needed = 0.0

    def list_methods(self, name):
        # A sphere has no face with lips.
        return [piece for piece in super().list_methods(name) if "face" not in piece.name and "lips" not in piece.name]


@dataclass(frozen=True)
class SphereThroughput(OfSphere, Throughput):
    pass


@dataclass(frozen=True)
class SphereWorkPrecision(OfSphere, WorkPrecision):
    pass


@dataclass(frozen=True)
class SphereRanks(OfSphere, Ranks):
    def tasks(self):
        # One energy is enough; the other goes the same way.
        return super().tasks()[::2]


@dataclass(frozen=True)
class SphereMeshError(OfSphere, MeshError):
    # So coarse a sphere is far from converged, and prisms are softer on it.
    bounds = dict.fromkeys(MeshError.bounds, 1.0) | {"tets": 0.0}


@dataclass(frozen=True)
class SphereAgreement(Agreement):
    """A small sphere, whose people no network knows."""

    def network(self):
        return None

    def person(self, level=None, seed=None):
        return small_sphere() if self.level == 1 else sphere(self.level)


@lru_cache
def small_sphere():
    head = layered_sphere(1)
    head = replace(head, regions={"lips": np.arange(len(head.bone)) < 5})
    return Sphere(SimpleNamespace(name="spheres"), np.zeros(3), head)


@dataclass(frozen=True)
class SphereFaceBenchmark(FaceBenchmark):
    alone = False

    def bodies(self):
        return sphere_bodies()


@lru_cache
def sphere_bodies():
    return nested_bodies(body_of(layered_sphere(1), front=-20.0))
