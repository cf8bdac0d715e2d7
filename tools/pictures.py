#!/usr/bin/env python3
"""Make the pictures of README and docs again: `python tools/pictures.py`, some minutes; `--stale` tells which are old.

docs/pictures.toml holds, for each picture, a digest of what it is drawn from and one of the PNG. A picture is old when
the default head, the shipped network, the simulator's meaning, or the code that draws it has changed since.
Pictures of pages need Chromium and playwright, that of the exported head npm, too; the own head needs the scan of Lee
Perry-Smith (--scan).
"""

from __future__ import annotations

import argparse
import hashlib
import shutil
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Callable, Iterable
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
RECORD = DOCS / "pictures.toml"
SCAN = ROOT.parent / "shared" / "data" / "heads" / "lee_perry_smith.glb"
DRAWING = ("animation/pictures.py", "animation/eyes_and_teeth.py", "lhm/identities/organs.py")
HEAD = ("lhm/identities/anny.npz", "lhm/identities/anny_within.npz", "reference/face/parameters.py")
NETWORK = ("surrogate/pretrained/anny.safetensors",)
NETWORKS = (*NETWORK, "surrogate/pretrained/anny-hypernetwork.safetensors")
PAGE = (
    "animation/app.js",
    "animation/scene.js",
    "animation/page.css",
    "animation/page.html",
    "animation/page.py",
    "animation/pictures.py",
    "animation/eyes_and_teeth.py",
    "lhm/identities/organs.py",
)
LIVE_PAGE = (
    "animation/live.js",
    "animation/live.html",
    "animation/live/controls.py",
    "animation/scene.js",
    "animation/page.css",
    "animation/pictures.py",
    "animation/eyes_and_teeth.py",
    "lhm/identities/organs.py",
)
CUT = (
    "benchmarks/studies/cases.py",
    "benchmarks/studies/agreement/solvers.py",
    "benchmarks/studies/agreement/pictures.py",
)
EXPORTED = ("tools/exported.html", "animation/export.py", *DRAWING[1:], "lhm/base/files/glb.py")
FINE = ("lhm/head/detail.py", "lhm/scans/detail.py", "lhm/identities/neck.py", "lhm/base/geometry/subdivision.py")
DIAL = ("benchmarks/results/dial.json", "benchmarks/studies/surrogate/dial.py")
ARENA = ("benchmarks/results/arena.json", "benchmarks/studies/arena/curves.py")
DRAWS = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"]
SMILE = {"mouthSmileLeft": 1.0, "mouthSmileRight": 1.0}
Maker = Callable[[Path], bytes]


def face(level: int = 2):
    """Return the mean person's head, its space and its code."""
    import numpy as np

    from softdeca.lhm import fit_head, identities, load_template

    space = identities.Anny()
    code = np.zeros(space.code_size)
    return fit_head(load_template(level=level), space.skin(code)), space, code


def jaw_open(scan: Path) -> bytes:
    """Draw jawOpen simulated, and how far blendshapes, the neo-Hookean law and the network are from it."""
    import numpy as np

    from softdeca.animation.pictures import Panel, draw_strip
    from softdeca.lhm import expressions
    from softdeca.reference import Parameters, apply_law, facial_scene, solve
    from softdeca.surrogate import Surrogate
    from softdeca.surrogate.methods import BLENDSHAPES, FENICSX_NEO_HOOKEAN, NETWORK

    head, space, code = face()
    weights, n = expressions.weights_of({"jawOpen": 0.8}), len(head.bone)
    shape = expressions.blend(space, code, weights)[0]
    scene = facial_scene(head, Parameters(), shape)
    fast = solve(scene)
    real = solve(apply_law(scene, "neo-Hookean"), solver="fenicsx", start=fast.positions, tolerance=1e-6)
    for solution in (fast, real):
        if not solution.converged:
            raise SystemExit(f"jaw-open: {solution.reason}")
    simulated, law = (head.skin_after(shape, solution.positions[:n]) for solution in (fast, real))
    network = Surrogate.load().bind(space.skin(code), code, Parameters()).frame(weights)
    drawn = head.skin.with_vertices(simulated)
    off = {BLENDSHAPES: shape, FENICSX_NEO_HOOKEAN: law, NETWORK: network}
    distances = {name: np.linalg.norm(skin - simulated, axis=1) for name, skin in off.items()}
    top = float(np.percentile(distances[BLENDSHAPES], 99.5))
    panels = [Panel("simulated (PD)", drawn, weights=weights)]
    panels += [Panel(f"{name} to PD", drawn, distance, top) for name, distance in distances.items()]
    return draw_strip(panels, rest=head.skin)


def weight(scan: Path) -> bytes:
    """Draw a neutral face and a smile, and both with 40 % more soft tissue."""
    from softdeca.animation.pictures import Panel, draw_strip
    from softdeca.lhm import expressions
    from softdeca.reference import Face, Parameters, solve

    head, space, code = face()
    weights = expressions.weights_of(SMILE)
    shapes, panels = space.expression_deltas(code), []
    for named, parameters in (("", Parameters()), (", + 40 % soft tissue", Parameters(soft_volume=1.4))):
        face_under = Face(head, shapes, parameters)
        smile = solve(face_under.scene(weights))
        if not smile.converged:
            raise SystemExit(f"weight: {smile.reason}")
        skin = face_under.skin_after(weights, smile.positions)
        panels.append(Panel(f"neutral{named}", head.skin.with_vertices(face_under.settled().skin)))
        panels.append(Panel(f"smile{named}", head.skin.with_vertices(skin), weights=weights))
    return draw_strip([panels[k] for k in (0, 2, 1, 3)], rest=head.skin)


def collisions(scan: Path) -> bytes:
    """Draw both lips cut open, the lower one raised, without contact and with it."""
    from softdeca.benchmarks.studies.agreement.pictures import draw_lips
    from softdeca.benchmarks.studies.cases import CASES
    from softdeca.benchmarks.studies.person import Person
    from softdeca.reference import Parameters
    from softdeca.surrogate.methods import METHODS, PD

    head, space, code = face()
    person, case = Person(space, code, head), CASES["collisions"]
    regions = {"without contact": (), "with contact": case.contact}
    rigs = {name: METHODS[PD].bind(person.face(Parameters(), kept)) for name, kept in regions.items()}
    return draw_lips(head, {name: rig.solve(case.weights).positions for name, rig in rigs.items()})


def effects(scan: Path) -> bytes:
    """Draw the effects that change a face's bones, volumes and halves, and the head outside the space."""
    return draw_effects(("bells-palsy", "weight-20", "weight-40", "jaw", "stylised"))


def more_effects(scan: Path) -> bytes:
    """Draw the others: skin, gravity, wrinkles and contact."""
    return draw_effects(("zombie", "gravity-3", "lying", "wrinkles", "collisions"))


def draw_effects(names: Iterable[str]) -> bytes:
    """Draw PD's answers to some cases of the mean person, and how far both networks are from them."""
    import numpy as np

    from softdeca.animation.contact_sheet import tile_pictures
    from softdeca.animation.pictures import Panel, draw_strip
    from softdeca.benchmarks.studies.cases import CASES
    from softdeca.benchmarks.studies.person import Person
    from softdeca.surrogate.methods import HYPERNETWORK, METHODS, NETWORK, PD, use_network

    head, space, code = face()
    person = Person(space, code, head)
    rows: dict[str, list[Panel]] = {PD: [], NETWORK: [], HYPERNETWORK: []}
    for case in map(CASES.__getitem__, names):
        changed = person if case.changed is None else person.change(case.changed(head), 2)
        shown_face = changed.face(case.parameters(changed.head), case.contact)
        figure = case.shown.partition(":")[0]
        skin = METHODS[PD].bind(shown_face).frame(case.weights)
        shown = changed.head.skin.with_vertices(skin)
        rows[PD].append(Panel(f"{figure}: {case.name}", shown, weights=case.weights))
        moved = np.linalg.norm(skin - shown_face.blend(case.weights) - shown_face.carried, axis=1)
        top = float(np.percentile(moved, 99.5))
        for name in (NETWORK, HYPERNETWORK):
            frame = use_network(name, beyond="clamp")(shown_face).frame(case.weights)
            off = np.linalg.norm(frame - skin, axis=1)
            rows[name].append(Panel(f"{name}, {100 * off.mean() / moved.mean():.0f} % left", shown, off, top))
    return tile_pictures([draw_strip(panels, size=260, rest=head.skin) for panels in rows.values()], 1)


def own_head(scan: Path) -> bytes:
    """Draw the fitted scan of Lee Perry-Smith at rest and simulated in three expressions."""
    from softdeca.animation.head_pictures import FRONT
    from softdeca.animation.pictures import Panel, draw_strip
    from softdeca.lhm import expressions, load_template, scans
    from softdeca.reference import Parameters, facial_scene, solve

    if not scan.is_file():
        raise SystemExit(f"own-head: no scan at {scan}; name the file by --scan")
    head = scans.fit_scan(load_template(), scan)
    panels = [Panel("a scan, fitted", head.skin)]
    for name, weights in (("jawOpen", {"jawOpen": 0.7}), ("smile", SMILE), ("browInnerUp", {"browInnerUp": 1.0})):
        shape = head.expression(expressions.weights_of(weights))
        solution = solve(facial_scene(head, Parameters(), shape))
        if not solution.converged:
            raise SystemExit(f"own-head, {name}: {solution.reason}")
        moved = head.skin_after(shape, solution.positions[: len(head.bone)])
        panels.append(Panel(f"{name}, simulated", head.skin.with_vertices(moved)))
    return draw_strip(panels, view=FRONT, framed=head.skin_wrap.vertices, rest=head.skin, fine=head.fine_skin)


def viewer(scan: Path) -> bytes:
    """Show the default head's page in Chromium with an open jaw, cut open, and take a screenshot."""
    from playwright.sync_api import sync_playwright

    from softdeca.animation.page import Rig, render_face_page
    from softdeca.reference import Face
    from softdeca.surrogate.methods import METHODS, NETWORK

    chromium = shutil.which("chromium") or shutil.which("chromium-browser")
    if chromium is None:
        raise SystemExit("viewer: Chromium is not installed")
    head, space, code = face()
    shown = Face(head, space.expression_deltas(code), code=code)
    rig = Rig.baked(NETWORK, METHODS[NETWORK].bind(shown))
    words = "Turn it with the mouse or a finger. The layers beneath move as the simulator says, to first order."
    text = render_face_page("the default head", words, shown, [rig])
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as play:
        file = Path(folder) / "view.html"
        file.write_text(text)
        browser = play.chromium.launch(executable_path=chromium, args=DRAWS)
        page = browser.new_page(viewport={"width": 1200, "height": 760})
        page.goto(file.as_uri())
        page.wait_for_function("window.viewer !== undefined")
        page.get_by_role("button", name="jaw open").click()
        page.evaluate("name => viewer.show(name)", rig.name)
        page.mouse.move(400, 400)
        page.mouse.down()
        page.mouse.move(330, 392, steps=5)
        page.mouse.up()
        page.locator("#cut").fill("0.5")
        page.wait_for_timeout(1000)
        picture = page.screenshot()
        browser.close()
    return picture


def live(scan: Path) -> bytes:
    """Show the live page in Chromium, smiling with more soft tissue, once the simulator has converged."""
    from playwright.sync_api import sync_playwright

    chromium = shutil.which("chromium") or shutil.which("chromium-browser")
    if chromium is None:
        raise SystemExit("live: Chromium is not installed")
    command = [sys.executable, "-c", "from softdeca.cli import main; main()", "view"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server, sync_playwright() as play:
        try:
            address = server.stdout.readline().split()[1]  # type: ignore[union-attr]
            browser = play.chromium.launch(executable_path=chromium, args=DRAWS)
            page = browser.new_page(viewport={"width": 1200, "height": 760})
            page.goto(address)

            def wait_for_simulator() -> None:  # the page's policy forbids what wait_for_function does
                while not page.evaluate("window.viewer && viewer.frame.last && viewer.frame.isAnswered"):
                    page.wait_for_timeout(200)

            wait_for_simulator()
            page.get_by_role("button", name="heavier").click()
            page.get_by_role("button", name="smile").click()
            page.get_by_role("radio", name="distance to blendshapes").check()
            page.mouse.move(400, 500)
            page.mouse.down()
            page.mouse.move(360, 496, steps=5)
            page.mouse.up()
            wait_for_simulator()
            page.wait_for_timeout(1000)
            picture = page.screenshot()
            browser.close()
        finally:
            server.terminate()
    return picture


def exported(scan: Path) -> bytes:
    """Open an exported head in three.js, with a slider for each morph target, and take a screenshot.

    Its positions there have to be the rig's own frame.
    """
    import numpy as np
    from playwright.sync_api import sync_playwright

    from softdeca.animation.export import simulated_rig
    from softdeca.lhm import expressions
    from softdeca.lhm.base.files.glb import write_glb
    from softdeca.lhm.base.progress import silent
    from softdeca.reference import Face, Parameters

    chromium, npm = shutil.which("chromium") or shutil.which("chromium-browser"), shutil.which("npm")
    if chromium is None or npm is None:
        raise SystemExit("exported: Chromium or npm is not installed")
    head, space, code = face()
    rig = simulated_rig(Face(head, space.expression_deltas(code), Parameters(soft_volume=1.1)), silent)
    named = {"jawOpen": 0.7, "mouthSmileLeft": 0.8, "browInnerUp": 0.6, "eyeSquintLeft": 0.4}
    skin = rig.surfaces[0]
    wanted = skin.rest.vertices + np.tensordot(expressions.weights_of(named), skin.targets, axes=1)
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as play:
        subprocess.run([npm, "install", "--silent", "--prefix", folder, "three@0.172.0"], check=True)
        write_glb(Path(folder) / "node_modules" / "rig.glb", rig)
        shutil.copy(ROOT / EXPORTED[0], Path(folder) / "node_modules" / "index.html")
        browser = play.chromium.launch(executable_path=chromium, args=DRAWS)
        page = browser.new_page(viewport={"width": 1000, "height": 780})
        # Modules do not load from file://.
        page.route(
            "http://exported/**",
            lambda route: route.fulfill(path=Path(folder, "node_modules", route.request.url.split("/", 3)[3])),
        )
        page.goto("http://exported/index.html")
        page.wait_for_function("window.ready")
        page.evaluate("named => setWeights(named)", named)
        apart = np.abs(1e3 * np.array(page.evaluate("positions('skin')")) - wanted).max()
        if apart > 0.01:
            raise SystemExit(f"exported: three.js has the skin {apart:.2g} mm off")
        picture = page.screenshot()
        browser.close()
    return picture


def dial(scan: Path) -> bytes:
    """Draw error against time of frames, by the kept results of the dial's study."""
    import json

    from softdeca.animation.plots import to_png
    from softdeca.benchmarks.studies.surrogate.dial import plot_dial

    results = json.loads((ROOT / DIAL[0]).read_text())
    return to_png(plot_dial([line for row in results["rows"] for line in row["values"]["rows"]]))


def arena(scan: Path) -> bytes:
    """Draw error over processor time of every solver of the arena, by its kept results."""
    import json

    from softdeca.animation.plots import to_png
    from softdeca.benchmarks.studies.arena.curves import plot_curves

    rows = [row for row in json.loads((ROOT / ARENA[0]).read_text())["rows"] if row["status"] == "done"]
    shown = [(row["case"], row["values"]) for row in rows if "seed" not in row["case"]]
    return to_png(plot_curves(shown))


PICTURES: dict[str, tuple[Maker, tuple[str, ...]]] = {
    "jaw-open.png": (jaw_open, (*HEAD, *NETWORK, *DRAWING)),
    "weight.png": (weight, (*HEAD, *DRAWING)),
    "collisions.png": (collisions, (*HEAD, *CUT)),
    "effects.png": (effects, (*HEAD, *NETWORKS, *DRAWING, *CUT[:2])),
    "more-effects.png": (more_effects, (*HEAD, *NETWORKS, *DRAWING, *CUT[:2])),
    "own-head.png": (own_head, (*HEAD, *DRAWING, *FINE, "lhm/template/registration/nonrigid.py")),
    "dial.png": (dial, DIAL),
    "arena.png": (arena, ARENA),
    "viewer.png": (viewer, (*HEAD, *NETWORK, *PAGE)),
    "exported.png": (exported, (*HEAD, *EXPORTED)),
    "live.png": (live, (*HEAD, *NETWORK, *LIVE_PAGE)),
}
"""Each picture with the function that makes it, and the files that it is drawn from."""


def digest_of(name: str) -> str:
    """Name what a picture is drawn from: its files, the simulator's meaning, and the function that makes it."""
    import inspect

    from softdeca.surrogate.corpus.simulate import GENERATOR

    make, sources = PICTURES[name]
    digest = hashlib.sha256(f"{GENERATOR} {SMILE}\n{inspect.getsource(make)}{inspect.getsource(face)}".encode())
    for source in sources:
        digest.update((ROOT / source).read_bytes())
    return digest.hexdigest()[:16]


def read_record() -> dict[str, dict[str, str]]:
    """Read what each picture in docs was drawn from."""
    return tomllib.loads(RECORD.read_text()) if RECORD.is_file() else {}


def find_stale() -> dict[str, str]:
    """Name the pictures that are old, each with why."""
    found, record = {}, read_record()
    for name in PICTURES:
        known = record.get(name)
        if known is None or not (DOCS / name).is_file():
            found[name] = "not made"
        elif known["inputs"] != digest_of(name):
            found[name] = "drawn from other inputs than today's"
        elif known["png"] != hashlib.sha256((DOCS / name).read_bytes()).hexdigest()[:16]:
            found[name] = "not the file that was drawn"
    return found


def make(names: Iterable[str], scan: Path) -> int:
    """Draw pictures into docs and record what they are of; exit status 1 if one could not be drawn."""
    status = 0
    for name in names:
        try:
            png = PICTURES[name][0](scan)
        except SystemExit as why:
            print(why, file=sys.stderr)
            status = 1
            continue
        (DOCS / name).write_bytes(png)
        record = read_record() | {name: {"inputs": digest_of(name), "png": hashlib.sha256(png).hexdigest()[:16]}}
        lines = ["# Written by tools/pictures.py: what each picture was drawn from, and its file."]
        lines += [f'["{name}"]\ninputs = "{of["inputs"]}"\npng = "{of["png"]}"' for name, of in sorted(record.items())]
        RECORD.write_text("\n\n".join(lines) + "\n")
        print(f"wrote {DOCS / name}", flush=True)
    return status


def main() -> int:
    """Make pictures, or tell which are old."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("names", nargs="*", metavar="PICTURE", help=f"default: all of {', '.join(PICTURES)}")
    parser.add_argument("--scan", type=Path, default=SCAN, help="of the own head, as glTF")
    parser.add_argument("--stale", action="store_true", help="only tell which are old; exit status 1 if some are")
    asked = parser.parse_args()
    if unknown := set(asked.names) - set(PICTURES):
        parser.error(f"no picture {', '.join(sorted(unknown))}; there are {', '.join(PICTURES)}")
    if not asked.stale:
        return make(asked.names or PICTURES, asked.scan)
    for name, why in find_stale().items():
        print(f"{name}: {why}")
    return 1 if find_stale() else 0


if __name__ == "__main__":
    sys.exit(main())
