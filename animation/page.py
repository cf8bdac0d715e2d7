"""One self-contained page: a head in 3D with the 52 sliders, by blendshapes, a rig and solvers, with its layers.

It opens from a local file and asks no network for anything. Positions travel as 16-bit numbers, one scale per target,
all of them packed by gzip.
"""

from __future__ import annotations

import base64
import gzip
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from importlib.resources import files
from typing import Any

import numpy as np
from jinja2 import Environment, StrictUndefined

from ..lhm import expressions
from ..lhm.base.errors import InputError
from ..lhm.base.mesh import Floats, Floats32, Surface
from ..lhm.head.detail import FineSkin
from ..lhm.identities.arkit import ARKIT
from ..reference import Face
from ..surrogate import BoundRig
from ..surrogate.methods import BLENDSHAPES, DERIVATIVES
from ..surrogate.rigs.rig import Remainder
from .eyes_and_teeth import TURN, find_eyes_and_teeth
from .pictures import INSIDE, light_share, parse_colour, to_linear_light

TOP = 2.0
"""[mm] Where the colours of distances end."""
FINEST = 1 / 32767
"""Step of a 16-bit number, over the largest number of a row."""


@dataclass(frozen=True, eq=False)
class Rig:
    """Morph targets: neutral (n, 3) and targets (k, n, 3) [mm] whose weights are the 52, times `mixing` if given.

    mixing (52 + m, k) takes also the m numbers that `remainder` adds to the 52.
    """

    name: str
    neutral: Floats | Floats32
    targets: Floats | Floats32
    mixing: Floats | Floats32 | None = None
    remainder: Remainder | None = None

    @classmethod
    def baked(cls, name: str, surrogate: BoundRig) -> Rig:
        """Bake a bound surrogate."""
        rig = surrogate.bake()
        return cls(name, rig.neutral, rig.targets, rig.mixing, rig.remainder_of)


@dataclass(frozen=True, eq=False)
class Pose:
    """An expression as weights (52,), and the skins [mm] (n, 3) that solvers have found for it, by name."""

    name: str
    weights: Floats
    skins: Mapping[str, Floats] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Layer:
    """A surface beneath the skin, outermost first, which is seen where the head is cut open.

    positions (n, 3) and targets (52, n, 3) [mm]; colour is red, green, blue in [0, 1].
    """

    name: str
    triangles: np.ndarray
    positions: Floats
    targets: Floats
    colour: tuple[float, float, float]


def render_page(
    title: str,
    words: str,
    triangles: np.ndarray,
    rigs: Sequence[Rig],
    *,
    poses: Sequence[Pose] = (),
    layers: Sequence[Layer] = (),
    fine: FineSkin | None = None,
) -> str:
    """The page as text; `words` stand beneath the title, the last rig is shown first. `fine` draws skins finer.

    Raises InputError without a rig, and for skins that are not all of one size.
    """
    if not rigs:
        raise InputError("viewer: there is no rig to show")
    n = len(rigs[0].neutral)
    packed = Packed()
    skins = [skin for pose in poses for skin in pose.skins.values()]
    for shape in [rig.neutral.shape for rig in rigs] + [np.shape(skin) for skin in skins]:
        if shape != (n, 3):
            raise InputError(f"viewer: skins of shapes {(n, 3)} and {shape} cannot be compared")
    skin = Surface(np.asarray(rigs[0].neutral, dtype=np.float64), np.asarray(triangles))
    content = pack_skin(packed, skin, fine) | {
        "top": TOP,
        "rigs": [_rig(packed, f"rig {k}", rig) for k, rig in enumerate(rigs)],
        "poses": [_pose(packed, k, pose, rigs[0].neutral) for k, pose in enumerate(poses)],
        "layers": [_layer(packed, k, layer) for k, layer in enumerate(layers)],
    }
    return fill_page("page.html", packed, content, app="app.js", title=title, words=words)


def pack_skin(packed: Packed, skin: Surface, fine: FineSkin | None = None) -> dict[str, Any]:
    """Pack what every page draws a skin with: triangles, where light reaches, eyes and teeth; the page's content."""
    triangles = skin.triangles if fine is None else fine.triangles
    ended = skin if fine is None else skin.with_vertices(fine.end_neck(skin.vertices))
    return {
        "expressions": list(ARKIT),
        "triangles": packed.add("triangles", np.asarray(triangles, dtype=np.uint32)),
        "fine": None if fine is None else _pack_fine(packed, fine),
        "lit": packed.add("lit", light_share(ended).astype(np.float32)),
        "inside": to_linear_light(parse_colour(INSIDE)).tolist(),
        "within": _pack_inside(packed, skin),
    }


def fill_page(template: str, packed: Packed, content: dict[str, Any], *, app: str, **words: str) -> str:
    """Fill a template of this folder with content, arrays, style, three.js, scene.js and the script `app`."""
    here = files(__package__)
    environment = Environment(autoescape=True, undefined=StrictUndefined)
    parts = {"style": "page.css", "three": "three.js", "scene": "scene.js", "app": app}
    return environment.from_string((here / template).read_text("utf-8")).render(
        # "</" would end the script that holds it.
        content=json.dumps(content | {"arrays": packed.table}, allow_nan=False).replace("</", "<\\/"),
        bytes=base64.b64encode(gzip.compress(packed.bytes, mtime=0)).decode(),
        **{name: (here / file).read_text("utf-8") for name, file in parts.items()},
        **words,
    )


def _rig(packed: Packed, where: str, rig: Rig) -> dict[str, Any]:
    def name(part: str) -> str:
        return f"{where} {part}"

    entry: dict[str, Any] = {
        "name": rig.name,
        "neutral": packed.add(name("neutral"), np.asarray(rig.neutral, dtype=np.float32)),
        "targets": packed.small(name("targets"), rig.targets),
        "mixing": None if rig.mixing is None else packed.add(name("mixing"), rig.mixing.astype(np.float32)),
        "network": None,
    }
    if rig.remainder is not None:
        entry["network"] = {
            part.name: packed.add(name(part.name), getattr(rig.remainder, part.name).astype(np.float32))
            for part in fields(rig.remainder)
        }
    return entry


def _pose(packed: Packed, k: int, pose: Pose, neutral: Floats | Floats32) -> dict[str, Any]:
    return {
        "name": pose.name,
        "weights": packed.add(f"pose {k}", np.asarray(pose.weights, dtype=np.float32)),
        "skins": {name: packed.small(f"pose {k} {name}", (skin - neutral)[None]) for name, skin in pose.skins.items()},
    }


def _pack_fine(packed: Packed, fine: FineSkin) -> dict[str, Any]:
    """Pack the map from the skin that moves to the one that is drawn."""
    steps = [
        {
            "starts": packed.add(f"fine {k} starts", step.indptr.astype(np.uint32)),
            "columns": packed.add(f"fine {k} columns", step.indices.astype(np.uint32)),
            "weights": packed.add(f"fine {k} weights", step.data.astype(np.float32)),
        }
        for k, step in enumerate(fine.steps)
    ]
    paint = None if fine.colours is None else to_linear_light(fine.colours).astype(np.float32)
    return {
        "steps": steps,
        "heights": packed.add("heights", fine.heights),
        "paint": None if paint is None else packed.add("paint", paint),
    }


def _pack_inside(packed: Packed, skin: Surface) -> dict[str, Any] | None:
    """Eyes and teeth, where the skin's are known."""
    organs = find_eyes_and_teeth(skin)
    if organs is None:
        return None
    bodies = [
        {
            "points": packed.add(f"within {k}", organ.points.astype(np.float32)),
            "carriers": packed.add(f"within {k} carriers", organ.carriers.astype(np.uint32)),
            "fit": packed.add(f"within {k} fit", organ.fit.astype(np.float32)),
            "side": organ.side,
            "centre": np.broadcast_to(organ.centre, 3).tolist(),
        }
        for k, organ in enumerate(organs.organs)
    ]
    return {
        "bodies": bodies,
        "turn": TURN,
        "triangles": packed.add("within triangles", organs.triangles.astype(np.uint32)),
        "colours": packed.add("within colours", to_linear_light(organs.colours).astype(np.float32)),
    }


def _layer(packed: Packed, k: int, layer: Layer) -> dict[str, Any]:
    return {
        "name": layer.name,
        "colour": layer.colour,
        "rig": _rig(packed, f"layer {k}", Rig(layer.name, layer.positions, layer.targets)),
        "triangles": packed.add(f"layer {k} triangles", layer.triangles.astype(np.uint32)),
    }


class Packed:
    """Arrays one after another in one block of bytes, with a table of where each begins."""

    def __init__(self) -> None:
        self.bytes = bytearray()
        self.table: dict[str, dict[str, Any]] = {}

    def add(self, name: str, array: np.ndarray, scale: Sequence[float] = ()) -> str:
        """An array as it is; `scale` of each of its rows, where it has one."""
        self.bytes += bytes(-len(self.bytes) % 4)
        entry = {"type": str(array.dtype), "offset": len(self.bytes), "length": int(array.size), "scale": list(scale)}
        self.table[name] = entry
        self.bytes += np.ascontiguousarray(array).tobytes()
        return name

    def small(self, name: str, rows: np.ndarray) -> str:
        """Rows (k, n, 3) as 16-bit numbers, each row with its own scale."""
        scale = np.maximum(np.abs(rows).max(axis=(1, 2)), 1e-9) * FINEST
        numbers = np.rint(rows / scale[:, None, None]).astype(np.int16)
        return self.add(name, numbers, scale.tolist())


POSES = {
    "jaw open": {"jawOpen": 0.8},
    "smile": {"mouthSmileLeft": 1.0, "mouthSmileRight": 1.0},
    "pucker": {"mouthPucker": 1.0},
    "blink": {"eyeBlinkLeft": 1.0, "eyeBlinkRight": 1.0},
    "puffed cheeks": {"cheekPuff": 1.0},
    "brows up": {"browInnerUp": 1.0, "browOuterUpLeft": 1.0, "browOuterUpRight": 1.0},
}
LAYERS = (("muscle", (0.66, 0.22, 0.2)), ("skull", (0.92, 0.89, 0.8)))


def render_face_page(
    title: str,
    words: str,
    face: Face,
    rigs: Sequence[Rig] = (),
    poses: Sequence[Pose] = (),
    *,
    detail: bool = False,
) -> str:
    """The page of a face: its blendshapes, the simulator's derivatives (some seconds), and `rigs`.

    `poses` replace the usual ones. With `detail` the page draws the head's fine skin. Raises InputError for a face that
    does not settle, and what the simulator raises.
    """
    head, shapes, motions, n = face.head, face.shapes, face.first_order, len(face.head.bone)
    simulated = Rig(DERIVATIVES, head.skin.vertices + face.offset, shapes + face.responses)
    below = (slice(n * k, n * (k + 1)) for k in (1, 2))
    return render_page(
        title,
        words,
        head.skin.triangles,
        [Rig(BLENDSHAPES, head.skin.vertices, shapes), simulated, *rigs],
        poses=poses or [Pose(name, expressions.weights_of(named)) for name, named in POSES.items()],
        layers=[
            Layer(name, head.skin_wrap.triangles, face.derivatives.answer.positions[rows], motions[:, rows], colour)
            for (name, colour), rows in zip(LAYERS, below, strict=True)
        ],
        fine=head.fine_skin if detail else None,
    )
