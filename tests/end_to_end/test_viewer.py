"""The 3D page in headless Chromium: it draws, its sliders move vertices as Python does, and it asks for nothing."""

import io
import json
import re
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from softdeca.animation.eyes_and_teeth import find_eyes_and_teeth
from softdeca.animation.page import Layer, Pose, Rig, render_face_page, render_page
from softdeca.lhm import expressions, identities
from softdeca.lhm.head.detail import FineSkin
from softdeca.reference import Face, Parameters
from softdeca.surrogate import Surrogate

SPACE = identities.Anny()
CODE = np.zeros(SPACE.code_size)


class Opened:
    """A page in the browser, with what it asked for and said."""

    def __init__(self, browser, file, width=1400, height=900):
        self.page = browser.new_page(viewport={"width": width, "height": height})
        self.said, self.asked = [], []
        self.page.on("console", lambda message: self.said.append(message.text))
        self.page.on("pageerror", lambda error: self.said.append(str(error)))
        self.page.on("request", lambda request: self.asked.append(request.url))
        self.page.goto(file.as_uri())
        self.page.wait_for_function("window.viewer !== undefined")

    def positions(self, weights, method):
        self.page.evaluate("weights => viewer.set(weights)", np.asarray(weights).tolist())
        self.page.evaluate("name => viewer.show(name)", method)
        return self.shown()

    def shown(self):
        return np.array(self.page.evaluate("viewer.positions()")).reshape(-1, 3)

    def picture(self):
        return np.asarray(Image.open(io.BytesIO(self.page.locator("#stage").screenshot())).convert("RGB")).astype(int)


@pytest.fixture(scope="module")
def bound():
    return Surrogate.load().bind(SPACE.skin(CODE), CODE)


@pytest.fixture(scope="module")
def file(tmp_path_factory, bound):
    """The default skin by blendshapes and surrogate, and a ball beneath that moves with the jaw."""
    skin, deltas = SPACE.skin(CODE), SPACE.expression_deltas(CODE)
    below = np.zeros_like(deltas)
    below[expressions.index("jawOpen"), :, 1] = -5.0
    inner = 0.5 * skin.vertices
    text = render_page(
        "a face </script> & more",
        "words",
        skin.triangles,
        [Rig("blendshapes", skin.vertices, deltas), Rig.baked("surrogate", bound)],
        poses=[Pose("smile", expressions.weights_of({"mouthSmileLeft": 1.0}), {"PD": skin.vertices + [0.0, 1.0, 0.0]})],
        layers=[Layer("ball", skin.triangles, inner, below, (0.7, 0.2, 0.2))],
    )
    path = tmp_path_factory.mktemp("view") / "view.html"
    path.write_text(text)
    return path


@pytest.fixture(scope="module")
def opened(browser, file):
    return Opened(browser, file)


def test_sliders_move_vertices_as_python_does(opened, bound):
    baked = bound.bake()
    for weights in (np.zeros(52), *np.random.default_rng(0).random((3, 52)), np.eye(52)[3]):
        assert np.abs(opened.positions(weights, "surrogate") - baked.frame(weights)).max() < 0.01
        assert np.abs(opened.positions(weights, "blendshapes") - bound.blend(weights)).max() < 0.01
    jaw = expressions.weights_of({"jawOpen": 0.5})
    opened.positions(np.zeros(52), "surrogate")
    slider = opened.page.locator('input[name="jawOpen"]')
    slider.evaluate("s => { s.value = 0.5; s.dispatchEvent(new Event('input')); }")
    assert np.abs(opened.shown() - baked.frame(jaw)).max() < 0.01


def test_eyes_and_teeth_move_as_python_says(opened, bound):
    for named in ({}, {"jawOpen": 0.7, "eyeLookOutLeft": 0.8, "eyeLookInRight": 0.8, "eyeLookUpLeft": 0.5}):
        weights = expressions.weights_of(named)
        skin = opened.positions(weights, "blendshapes")
        found = np.array(opened.page.evaluate("viewer.within()")).reshape(-1, 3)
        assert np.abs(found - find_eyes_and_teeth(SPACE.skin(CODE)).place(skin, weights)).max() < 0.01


def test_the_fine_skin_is_drawn_as_python_draws_it(browser, tmp_path):
    skin, deltas = SPACE.skin(CODE), SPACE.expression_deltas(CODE)
    fine = FineSkin.from_skin(skin)
    fine = replace(fine, heights=np.random.default_rng(0).uniform(-0.3, 0.3, len(fine.heights)).astype(np.float32))
    rig = Rig("blendshapes", skin.vertices, deltas)
    (tmp_path / "fine.html").write_text(render_page("fine", "words", skin.triangles, [rig], fine=fine))
    opened = Opened(browser, tmp_path / "fine.html")
    moved = opened.positions(expressions.weights_of({"jawOpen": 0.7}), "blendshapes").astype(np.float64)
    drawn = np.array(opened.page.evaluate("viewer.drawn()")).reshape(-1, 3)
    off = np.linalg.norm(drawn - fine.refine(moved).vertices, axis=1)
    # Where triangles fold flat, normals turn with rounding.
    assert np.quantile(off, 0.999) < 1e-3 and off.max() < 0.7
    assert opened.said == []
    opened.page.close()


def test_a_solvers_answer_is_shown_in_its_pose_alone(opened):
    opened.page.get_by_role("button", name="smile").click()
    opened.page.select_option("#shown", "PD")
    assert np.abs(opened.shown() - SPACE.skin(CODE).vertices - [0.0, 1.0, 0.0]).max() < 1e-3
    opened.page.select_option("#against", "blendshapes")
    assert re.fullmatch(r"mean \d\.\d\d mm, at most \d+\.\d\d mm", opened.page.locator("#distance").inner_text())
    opened.page.get_by_role("button", name="neutral").click()
    assert opened.page.locator("#shown").input_value() == "surrogate"
    assert opened.page.locator('#shown option[value="PD"]').is_disabled()
    opened.page.select_option("#against", "")


def test_it_draws_and_cuts_open(opened):
    opened.page.evaluate("viewer.set(Array(52).fill(0))")
    opened.page.wait_for_timeout(200)
    whole = opened.picture()
    drawn = np.abs(whole - whole[0, 0]).sum(axis=2) > 30
    assert 0.1 < drawn.mean() < 0.7
    cut = opened.page.locator("#cut")
    cut.evaluate("s => { s.value = 0.5; s.dispatchEvent(new Event('input')); }")
    opened.page.wait_for_timeout(200)
    image = opened.picture()
    red = (image[..., 0] > image[..., 1] + 60) & (image[..., 0] > image[..., 2] + 60)
    assert red.mean() > 0.01 and red[:, : red.shape[1] // 2 - 5].mean() == 0.0
    cut.evaluate("s => { s.value = 1; s.dispatchEvent(new Event('input')); }")


def test_it_says_and_asks_for_nothing(opened, file):
    assert opened.page.title() == "a face </script> & more"
    assert opened.said == [] and opened.asked == [file.as_uri()]


def test_it_fits_a_phone(browser, file):
    opened = Opened(browser, file, 390, 844)
    assert opened.page.evaluate("document.documentElement.scrollWidth") == 390
    stage = opened.page.locator("#stage").bounding_box()
    assert stage["width"] == 390 and stage["height"] > 300
    opened.page.close()


def test_the_page_of_a_simulated_head(sphere_head):
    deltas = np.zeros((52, len(sphere_head.skin.vertices), 3))
    deltas[:, :, 0] = 1.0
    parameters = Parameters(soft_volume=1.2)
    text = render_face_page("ball", "words", Face(sphere_head, deltas, parameters))
    content = json.loads(re.search(r'<script id="content" type="application/json">(.*?)</script>', text, re.S)[1])
    assert [rig["name"] for rig in content["rigs"]] == ["blendshapes", "derivatives"]
    assert [layer["name"] for layer in content["layers"]] == ["muscle", "skull"] and len(content["poses"]) == 6
