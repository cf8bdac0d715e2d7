"""ICT-FaceKit's and BodyParts3D's folders made files, by small folders of the same form."""

import numpy as np
import pytest
import trimesh

from softdeca.lhm import expressions, identities
from softdeca.lhm.anatomy import bodyparts
from softdeca.lhm.base.geometry.surfaces import geodesic_sphere
from softdeca.lhm.identities import ict
from softdeca.lhm.identities.space import CAP, EYES, MOUTH, OUTSIDE

from ..robustness.whole_files import grouped_obj

NOTICE = "Copyright (c) somebody"


@pytest.fixture(scope="module")
def facekit(tmp_path_factory):
    """The folder of a model of few vertices [cm], and how many triangles its parts have."""
    folder = tmp_path_factory.mktemp("ICT-FaceKit") / "FaceXModel"
    folder.mkdir()
    unit, triangles = geodesic_sphere(16)
    x = unit * [7.5, 11.5, 9.0]
    centre = x[triangles].mean(axis=1)
    part = np.where(centre[:, 2] > 4.0, 0, 1)
    places = [(0, -4.5, 8.5), (3.3, 3.0, 7.5), (-3.3, 3.0, 7.5)]
    for number, (place, radius) in enumerate(zip(places, (2.2, 1.6, 1.6), strict=True), start=2):
        part[np.linalg.norm(centre - place, axis=1) < radius] = number
    part[centre[:, 1] < -9.0] = -1  # the neck is open
    order = np.argsort(part, kind="stable")[(part == -1).sum() :]
    ball, more = geodesic_sphere(2)
    mesh = np.vstack([triangles[order], more + len(x)])
    counts = (*np.bincount(part[order], minlength=5).tolist(), len(more))
    neutral = np.vstack([x, ball + [3.3, 3.0, 6.0]])
    opened = neutral - [0, 1.5, 0] * (neutral[:, [1]] < -4.0)
    shapes = {"generic_neutral_mesh": neutral, "jawOpen": opened, "cheekRaiser_L": neutral + 1.0}
    shapes |= {"browInnerUp_L": neutral + [0, 0.2, 0], "browInnerUp_R": neutral + [0, 0.3, 0]}
    shapes |= {f"identity00{k}": neutral * (1.0 + 0.1 * (k + 1)) for k in range(3)}
    for name, vertices in shapes.items():
        (folder / f"{name}.obj").write_text(grouped_obj(vertices, mesh, comment="#" * 40 + f"\n{NOTICE}\n" + "#" * 40))
    names = ("face", "head_neck", "mouth_socket", "eye_socket_l", "eye_socket_r", "teeth")
    return folder, len(neutral), tuple(zip(names, counts, strict=True))


@pytest.fixture
def small(facekit, monkeypatch):
    folder, vertices, parts = facekit
    monkeypatch.setattr(ict, "KIT_VERTICES", vertices)
    monkeypatch.setattr(ict, "KIT_PARTS", parts)
    monkeypatch.setattr(ict, "CODE_SIZE", 2)
    return folder


def test_a_folder_of_facekits_form_becomes_a_space(small, command, tmp_path):
    file = tmp_path / "ict.npz"
    ended = command("head", "import", "ict", small.parent, "--out", file)
    assert ended.status == 0 and ended.out.splitlines()[-1] == f"wrote {file}"
    assert "2 identity shapes, 3 expression shapes" in ended.out and "without browDownLeft, " in ended.out
    assert NOTICE in str(np.load(file)["license"]) and "#" not in str(np.load(file)["license"])
    space = identities.from_text(f"ict:{file}")
    top = space.mean.vertices[:, 1].max()
    assert top == pytest.approx(115.0) and set(space.parts) == {OUTSIDE, MOUTH, EYES, CAP}
    # Both halves of an expression add up, and what has no ARKit name is nowhere.
    np.testing.assert_allclose(space.expressions[expressions.index("browInnerUp")][:50, 1], 5.0, atol=1e-4)
    jaw = space.expressions[expressions.index("jawOpen")][:, 1]
    assert jaw.min() == pytest.approx(-15.0, abs=1e-3) and jaw.max() == pytest.approx(0.0, abs=1e-3)
    assert space.code_size == 2 and len(space.missing) == 50
    grown = space.skin([1.0, 0.0]).vertices[:, 1].max()
    assert grown == pytest.approx(1.1 * top, rel=1e-5)


def parts_of_a_body():
    """A box per part of `bodyparts.FMA_PARTS`, the left ones at x > 0, in the body's coordinates [mm]."""
    for group, text in bodyparts.FMA_PARTS.items():
        for row, (number, name) in enumerate(bodyparts._list_names(text)):
            side = -1 if name.startswith("right") else 1 if name.startswith("left") else 0
            height = 1480.0 + row + 20.0 * ("upper" in name) + 60.0 * (group == "other")
            box = trimesh.creation.box((4.0, 4.0, 4.0))
            yield f"FMA{number}", name, box.vertices + [30.0 * side, -130.0, height], box.faces


@pytest.fixture(params=["3.0", "4.0"])
def body(request, tmp_path):
    folder = tmp_path / "bodyparts" / "obj"
    folder.mkdir(parents=True)
    number = 1000
    for concept, name, vertices, faces in parts_of_a_body():
        if request.param == "3.0":
            if "sclera" not in name:
                balls = np.vstack([vertices + [30.0, 0, 0], vertices - [30.0, 0, 0]])  # both eyes are one part there
                both = np.vstack([faces, faces + len(vertices)])
                whole = (balls, both) if name == "eyeball" else (vertices, faces)
                (folder / f"{concept}.obj").write_text(grouped_obj(*whole))
        elif name != "eyeball":
            head = f"File ID : FJ{number}\nRepresentation ID : BP1\nConcept ID : {concept}\nEnglish name : {name}"
            halves = [faces[:6], faces[6:]] if name == "mandible" else [faces]
            for piece in [*halves, halves[0]] if name == "mandible" else halves:
                used, numbers = np.unique(piece, return_inverse=True)
                text = grouped_obj(vertices[used], numbers.reshape(-1, 3), comment=head)
                (folder / f"FJ{number}.obj").write_text(text)
                number += 1
    (folder / "FJ1.obj").write_text("# Concept ID : FMA9999\nv none\n")  # some other organ, which nobody reads
    (folder / "FJ2.obj").write_text("")
    return folder


def test_a_folder_of_bodyparts_becomes_anatomy(body, command, tmp_path):
    file = tmp_path / "bones.npz"
    ended = command("head", "import", "bodyparts3d", body.parent, "--out", file)
    assert ended.status == 0 and ended.out.splitlines()[-1] == f"wrote {file}" and "without" not in ended.out
    anatomy = bodyparts.load(file)
    assert len(anatomy.muscles) == 59 and "left zygomaticus major" in anatomy.muscles
    # Up and forward are the body's z and -y, about a point in its head.
    np.testing.assert_allclose(anatomy.eyes[:, 0], [30.0, -30.0], atol=1e-4)
    np.testing.assert_allclose(anatomy.eyes[:, 2], 10.0, atol=1e-4)
    assert anatomy.eyes[0, 1] > anatomy.bite[1] and anatomy.bite[0] == pytest.approx(0.0, abs=2.1)
    # The mandible has its twelve triangles once, though pieces of it come twice, and the lower teeth.
    assert len(anatomy.mandible.triangles) == 12 * 15
    volume = trimesh.Trimesh(anatomy.mandible.vertices, anatomy.mandible.triangles).volume
    assert volume == pytest.approx(64.0 * 15, rel=1e-4)  # turned, not mirrored


def test_bodies_that_lack_parts_are_named(body, command, tmp_path):
    file = next(f for f in body.glob("*.obj") if f.stem == "FMA9710" or "FMA9710\n" in f.read_text())
    file.unlink()
    assert bodyparts.missing_parts(bodyparts.read_folder(body)) == ["vomer"]
    ended = command("head", "import", "bodyparts3d", body, "--out", tmp_path / "bones.npz")
    assert ended.status == 0 and "without vomer" in ended.out
