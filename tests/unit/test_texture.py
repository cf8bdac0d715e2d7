"""A scan's texture: read from OBJ and glTF, found at points of the scan, and kept as colours of the fine skin."""

import base64
import io

import numpy as np
import pytest
from PIL import Image

from softdeca.animation.pictures import shade_skin
from softdeca.lhm import identities, load_template, scans
from softdeca.lhm.base.files.surface_file import read_scan
from softdeca.lhm.base.files.texture import read_texture
from softdeca.lhm.head.file import load_head, save_head

from ..refusals import refused
from ..robustness.whole_files import Gltf

QUARTERS = np.array([[[255, 0, 0], [0, 255, 0]], [[0, 0, 255], [255, 255, 255]]], dtype=np.uint8)
"""Red, green; blue, white: from the upper left."""
SQUARE = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"
CORNERS = "vt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n"


def write_picture(path, size=64):
    Image.fromarray(np.repeat(np.repeat(QUARTERS, size, 0), size, 1)).save(path)


def colours_of(texture, points):
    """Colours at points (k, 2) of the unit square."""
    return texture.find_colours(np.column_stack([points, np.zeros(len(points))]))[0]


def write_obj(
    folder,
    faces="f 1/1 2/2 3/3 4/4\n",
    materials="newmtl skin\nmap_Kd picture.png\n",
    corners=CORNERS,
    libraries="mtllib square.mtl",
    name="picture.png",
):
    write_picture(folder / name)
    (folder / "square.mtl").write_text(materials)
    (folder / "square.obj").write_text(f"{libraries}\n{SQUARE}{corners}usemtl skin\n{faces}")
    return folder / "square.obj"


MIDDLES = np.array([[0.25, 0.75], [0.75, 0.75], [0.25, 0.25], [0.75, 0.25]])
"""Middles of the quarters in the order of QUARTERS, y up."""


def test_an_obj_has_its_colours(tmp_path):
    texture = read_texture(write_obj(tmp_path))
    assert np.allclose(colours_of(texture, MIDDLES), QUARTERS.reshape(4, 3))
    # Negative numbers count back.
    again = write_obj(tmp_path, "f 1/-4 2/-3 3/-2 4/-1\n")
    assert np.allclose(colours_of(read_texture(again), MIDDLES), QUARTERS.reshape(4, 3))


MAPS = {
    "tabs": {"materials": "newmtl skin\n\tmap_Kd\tpicture.png\n", "corners": CORNERS.replace("vt ", "vt\t")},
    "small letters": {"materials": "newmtl skin\nmap_kd picture.png\n"},
    "a byte order mark": {"materials": "\ufeffnewmtl skin\nmap_Kd picture.png\n"},
    "options": {"materials": "newmtl skin\nmap_Kd -s 1 1 1 -clamp on picture.png\n"},
    "Windows": {"materials": "newmtl skin\nmap_Kd .\\below\\picture.png\n", "name": "below/picture.png"},
    "capitals": {"materials": "NEWMTL skin\nMAP_KD picture.png\n"},
    "quotes": {"materials": 'newmtl skin\nmap_Kd "picture.png"\n'},
    "a comment": {"materials": "newmtl skin\nmap_Kd picture.png # x\n"},
    "a comment on use": {"faces": "usemtl skin # x\nf 1/1 2/2 3/3 4/4\n"},
    "spaces": {"materials": "newmtl skin\nmap_Kd my picture.png\n", "name": "my picture.png"},
    "two libraries": {"libraries": "mtllib other.mtl square.mtl"},
    "libraries in two lines": {"libraries": "mtllib square.mtl\nmtllib other.mtl"},
    "scaled": {
        "materials": "newmtl skin\nmap_Kd -o .5 0 -s .5 1 picture.png\n",
        "corners": "vt -1 0\nvt 1 0\nvt 1 1\nvt -1 1\n",
    },
}


@pytest.mark.parametrize("name", MAPS)
def test_maps_of_materials_are_found_as_the_format_has_them(tmp_path, name):
    (tmp_path / "below").mkdir()
    (tmp_path / "other.mtl").write_text("newmtl other\nKd 1 1 1\n")
    texture = read_texture(write_obj(tmp_path, **MAPS[name]))
    assert np.allclose(colours_of(texture, MIDDLES), QUARTERS.reshape(4, 3))


def test_the_picture_of_most_triangles_counts_and_grey_keeps_its_16_bits(tmp_path):
    Image.fromarray(np.full((4, 4), 85 * 257, np.uint16)).save(tmp_path / "grey.png")
    faces = (
        "usemtl a\nf 1/1 2/2 3/3\nf 1/1 3/3 4/4\nusemtl b\nf 1/1 2/2 3/3\nf 1/1 3/3 4/4\nusemtl skin\nf 1/1 2/2 3/3\n"
    )
    materials = "newmtl a\nmap_Kd grey.png\nnewmtl b\nmap_Kd grey.png\nnewmtl skin\nmap_Kd picture.png\n"
    texture = read_texture(write_obj(tmp_path, faces, materials))
    assert len(texture.triangles) == 4 and texture.others == 1 and np.allclose(colours_of(texture, MIDDLES), 85)


def test_materials_without_a_picture_have_no_colours(tmp_path):
    texture = read_texture(write_obj(tmp_path, "f 1/1 2/2 3/3\nusemtl hair\nf 1/1 3/3 4/4\n"))
    colours, distance = texture.find_colours(np.array([[0.9, 0.1, 0.0], [0.0, 1.0, 0.0]]))
    assert len(texture.triangles) == 1 and distance[0] < 1e-9 and distance[1] > 0.7


def test_a_scan_without_a_picture_has_no_texture(tmp_path):
    assert read_texture(write_obj(tmp_path, materials="newmtl skin\nKd 1 0 0\n")) is None
    (tmp_path / "bare.obj").write_text(SQUARE + "f 1 2 3 4\n")
    assert read_texture(tmp_path / "bare.obj") is None
    (tmp_path / "scan.stl").write_bytes(b"")
    assert read_texture(tmp_path / "scan.stl") is None


PLACES = np.array([[0, 1], [1, 1], [1, 0], [0, 0]], "<f4")


def write_gltf(path, places=PLACES, used=(), sampler=None, texture=None, second=None, **material):
    """A square as a glTF whose node mirrors it; the picture stands within the file."""
    x = np.array([[0, 0, 0], [-1, 0, 0], [-1, 1, 0], [0, 1, 0]], "<f4")
    corners = np.array([0, 2, 1, 0, 3, 2], "<u4")
    picture = io.BytesIO()
    Image.fromarray(np.repeat(np.repeat(QUARTERS, 64, 0), 64, 1)).save(picture, "PNG")
    gltf = Gltf(
        scenes=[{"nodes": [0]}],
        nodes=[{"mesh": 0, "scale": [-1, 1, 1]}],
        materials=[{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0, **dict(used)}}} | material],
        textures=[texture or {"source": 0, "sampler": 0}],
        samplers=[{"wrapS": sampler, "wrapT": sampler} if sampler else {}],
        images=[{"uri": f"data:image/png;base64,{base64.b64encode(picture.getvalue()).decode()}"}],
    )
    attributes = {"POSITION": gltf.add(x), "TEXCOORD_0": gltf.add(places.astype("<f4"))}
    if second is not None:
        attributes["TEXCOORD_1"] = gltf.add(second)
    gltf.mesh({"attributes": attributes, "indices": gltf.add(corners), "material": 0})
    path.write_bytes(gltf.glb())
    return path


def test_a_gltf_has_its_colours_where_its_node_puts_them(tmp_path):
    file = write_gltf(tmp_path / "square.glb")
    scan, texture = read_scan(file), read_texture(file)
    assert np.allclose(texture.vertices, scan.vertices)
    assert np.allclose(colours_of(texture, MIDDLES), QUARTERS.reshape(4, 3))
    assert read_texture(write_gltf(tmp_path / "plain.glb", pbrMetallicRoughness={})) is None


def transform(**how):
    return {"extensions": {"KHR_texture_transform": how}}


TURNED = PLACES @ np.array([[0.6, 0.8], [-0.8, 0.6]])
ALL, RIGHT_HALF = [0, 1, 2, 3], [1, 1, 3, 3]
# KHR_texture_transform's words give these (counter-clockwise in an image whose v runs down), and those of samplers.
LOOKS = {
    "scaled": ({"places": PLACES / 2, "used": transform(scale=[2, 2])}, ALL),
    "flipped": ({"places": PLACES * [1, -1] + [0, 1], "used": transform(offset=[0, 1], scale=[1, -1])}, ALL),
    "turned": ({"places": TURNED, "used": transform(rotation=float(np.arctan2(0.8, 0.6)))}, ALL),
    "second coordinates": ({"places": 0 * PLACES, "second": PLACES, "used": {"texCoord": 1}}, ALL),
    "second by the extension": ({"places": 0 * PLACES, "second": PLACES, "used": transform(texCoord=1)}, ALL),
    "repeated": ({"places": PLACES + 3}, ALL),
    "clamped": ({"places": PLACES + [1, 0], "sampler": 33071}, RIGHT_HALF),
    "mirrored": ({"places": PLACES + [1, 0], "sampler": 33648}, [1, 0, 3, 2]),
}


@pytest.mark.parametrize("name", LOOKS)
def test_a_picture_lies_where_gltf_puts_it(tmp_path, name):
    options, quarters = LOOKS[name]
    texture = read_texture(write_gltf(tmp_path / "square.glb", **options))
    assert np.allclose(colours_of(texture, MIDDLES), QUARTERS.reshape(4, 3)[quarters])


def test_a_factor_multiplies_light(tmp_path):
    """Half of a white's light is 188 on a screen, as sRGB has it."""
    look = {"baseColorTexture": {"index": 0}, "baseColorFactor": [0.5, 0.5, 0.5, 1]}
    texture = read_texture(write_gltf(tmp_path / "square.glb", pbrMetallicRoughness=look))
    assert np.allclose(colours_of(texture, MIDDLES), QUARTERS.reshape(4, 3) / 255 * 187.5, atol=0.1)


UNREAD = {
    "Basis Universal": {"texture": {"extensions": {"KHR_texture_basisu": {"source": 0}}}},
    "no triangle has a place in its picture": {"used": {"texCoord": 3}},
}


@pytest.mark.parametrize("words", UNREAD)
def test_a_picture_that_is_left_out_is_told(tmp_path, words):
    refused(words, read_texture, write_gltf(tmp_path / "square.glb", **UNREAD[words]))


def test_a_head_keeps_the_colours_of_its_scan(tmp_path):
    """A scan in the template's triangles, red where x > 0 and blue where it is not, as seen from the front."""
    skin = identities.Anny().mean
    x, y = skin.vertices[:, 0], skin.vertices[:, 1]
    places = np.stack([np.where(x > 0.0, 0.2, 0.8), 0.5 + 0.0 * y], 1)
    Image.fromarray(np.array([[[255, 0, 0], [0, 0, 255]]], np.uint8).repeat(50, 1)).save(tmp_path / "picture.png")
    (tmp_path / "head.mtl").write_text("newmtl skin\nmap_Kd picture.png\n")
    lines = ["mtllib head.mtl", "usemtl skin", *(f"v {a:.6f} {b:.6f} {c:.6f}" for a, b, c in skin.vertices)]
    lines += [f"vt {u} {v}" for u, v in places]
    lines += ["f " + " ".join(f"{k}/{k}" for k in triangle + 1) for triangle in skin.triangles]
    (tmp_path / "head.obj").write_text("\n".join(lines) + "\n")
    template = load_template(level=1)
    head = scans.fit_scan(template, tmp_path / "head.obj")
    assert "texture: a picture of 100 x 1" in head.notes and not head.detail.heights.any()
    save_head(tmp_path / "head.npz", head)
    again = load_head(tmp_path / "head.npz")
    assert np.array_equal(again.detail.colours, head.detail.colours)
    fine = again.fine_skin
    across = fine.refine(again.skin.vertices).vertices[:, 0]
    for side, colour in ((across > 15.0, (255, 0, 0)), (across < -15.0, (0, 0, 255))):
        assert (fine.colours[side] == colour).all(axis=1).mean() > 0.95  # the neck's end lies off the scan
    drawn = shade_skin(again.skin, fine)
    assert np.median(drawn[across > 15.0, 0]) == 255 and np.median(drawn[across < -15.0, 2]) == 255
    # A picture that is gone is told, and refuses nothing.
    (tmp_path / "picture.png").unlink()
    assert any("texture: left out" in note for note in scans.place_scan(template, tmp_path / "head.obj").notes)
