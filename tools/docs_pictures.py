#!/usr/bin/env python3
"""Draw the pictures of README and docs anew, in some minutes: .venv/bin/python tools/docs_pictures.py [NAME ...].

Each PNG names the sources that drew it; a test says when they have changed since. The viewer's needs chromium.
"""

import hashlib
import io
import shutil
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from PIL import Image
from PIL.PngImagePlugin import PngInfo

DOCS, ROOT = Path(__file__).parents[1] / "docs", Path(__file__).parents[1]
SOURCES = ("tools/docs_pictures.py", "viewer/pictures.py", "viewer/within.py", "viewer/shading.py")
PAGE = (*SOURCES, "viewer/page.py", "viewer/page.html", "viewer/app.js", "viewer/face.py")
DREW = "sources"
"""Text chunk with the digest of the sources."""
SIZE = 300


def jaw_open() -> bytes:
    """An open jaw, and the errors of blendshapes, neo-Hookean law and surrogate."""
    from softdeca.benchmarks.studies.agreement import Agreement

    return Agreement().make("jawOpen").picture()


def weight() -> bytes:
    """Neutral and smile, and both with 40 % more soft tissue."""
    from softdeca.benchmarks.studies.person import person
    from softdeca.lhm import expressions
    from softdeca.reference import Parameters, settled, solve
    from softdeca.viewer.pictures import Panel, strip

    of = person("anny", None)
    smile = expressions.weights_of({"mouthSmileLeft": 1.0, "mouthSmileRight": 1.0})
    panels = []
    for words, parameters in (("", Parameters()), (", 40 % more soft tissue", Parameters(soft_volume=1.4))):
        face = settled(of.head, parameters)
        for name, weights in (("neutral", np.zeros(52)), ("smile", smile)):
            shape = of.blend(weights[None])[0]
            skin = face.skin_after(shape, solve(face.scene(shape)).positions)
            panels.append(Panel(f"{name}{words}", of.head.skin.with_vertices(skin), weights=weights))
    return strip(panels, size=SIZE, rest=of.head.skin)


def own_head() -> bytes:
    """A scan in metres that lies on its back, the head that is found in it, and its open jaw."""
    import trimesh

    from softdeca.benchmarks.head_pictures import deltas_of, posed
    from softdeca.lhm import Surface, expressions, identities, load_template, scans
    from softdeca.viewer.pictures import Panel, strip

    _, someone = identities.Anny().sample(np.random.default_rng(3))
    lying = someone.vertices @ np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]).T
    with tempfile.TemporaryDirectory() as folder:
        scan = Path(folder) / "scan.ply"
        trimesh.Trimesh(1e-3 * lying, someone.triangles[:, [1, 2, 0]], process=False).export(scan)
        head = scans.fit_scan(scan, load_template())
    _, moved = posed(head, deltas_of(head, "scan"), expressions.weights_of({"jawOpen": 1.0}))
    came = Surface(lying - lying.mean(axis=0) + head.skin.vertices.mean(axis=0), someone.triangles[:, [1, 2, 0]])
    found = [Panel("the head that is found in it", head.skin), Panel("its jaw open, simulated", moved)]
    return _beside(
        strip([Panel("a scan in metres, on its back", came)], size=SIZE), strip(found, size=SIZE, rest=head.skin)
    )


def _beside(*pictures: bytes) -> bytes:
    images = [Image.open(io.BytesIO(picture)) for picture in pictures]
    whole = Image.new("RGB", (sum(image.width for image in images), max(image.height for image in images)), "white")
    left = 0
    for image in images:
        whole.paste(image, (left, whole.height - image.height))
        left += image.width
    buffer = io.BytesIO()
    whole.save(buffer, "PNG")
    return buffer.getvalue()


def viewer() -> bytes:
    """The page of `softdeca view`, at the smile, with the surrogate shown."""
    from playwright.sync_api import sync_playwright

    from softdeca.cli.app import app

    chromium = shutil.which("chromium")
    if chromium is None:
        sys.exit("chromium is not installed: tools/set-up")
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as play:
        page = Path(folder) / "view.html"
        app.main(["view", "--out", str(page)], standalone_mode=False)
        flags = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"]
        browser = play.chromium.launch(executable_path=chromium, args=flags)
        tab = browser.new_page(viewport={"width": 1100, "height": 700})
        tab.goto(page.as_uri())
        tab.wait_for_function("window.viewer !== undefined")
        tab.get_by_role("button", name="smile").click()
        tab.wait_for_timeout(1000)
        picture = tab.screenshot()
        browser.close()
    return picture


PICTURES: dict[str, tuple[Callable[[], bytes], Sequence[str]]] = {
    "jaw-open": (jaw_open, SOURCES),
    "weight": (weight, SOURCES),
    "own-head": (own_head, SOURCES),
    "viewer": (viewer, PAGE),
}


def digest(sources: Sequence[str]) -> str:
    """Of the contents of files of this repository."""
    return hashlib.sha256(b"".join((ROOT / name).read_bytes() for name in sources)).hexdigest()[:16]


def draw_pictures(names: Sequence[str]) -> None:
    """Draw the pictures of these names, by default all."""
    for name in names or PICTURES:
        draw, sources = PICTURES[name]
        image, notes = Image.open(io.BytesIO(draw())).convert("RGB"), PngInfo()
        notes.add_text(DREW, digest(sources))
        image.save(DOCS / f"{name}.png", pnginfo=notes, optimize=True)
        print(f"wrote {DOCS / name}.png")


if __name__ == "__main__":
    draw_pictures(sys.argv[1:])
