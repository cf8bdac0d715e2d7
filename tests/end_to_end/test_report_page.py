"""The report in headless Chromium, on a desk and on a phone: nothing is cut off, and no text stands in another."""

import json
from pathlib import Path

import numpy as np
import pytest

from softdeca.animation.pictures import Panel, draw_strip
from softdeca.benchmarks.harness.report import read_part, write_report
from softdeca.benchmarks.studies import load_study
from softdeca.lhm.base.geometry.surfaces import geodesic_sphere
from softdeca.lhm.base.mesh import Surface
from softdeca.surrogate import methods as m

from ..unit.test_contest import make_line

RESULTS = Path(__file__).parents[2] / "benchmarks" / "results"
OVERLAPS = """() => {
  const seen = element => { const r = element.getBoundingClientRect(); return r.width > 0 && r.height > 0; };
  const turn = text => Number((/rotate\\((-?[\\d.]+)/.exec(text.outerHTML) || [0, 0])[1]);
  const upright = text => turn(text) % 90 === 0;
  const found = [];
  for (const svg of [...document.querySelectorAll("svg")].filter(seen)) {
    const texts = [...svg.querySelectorAll("text")].filter(text => seen(text) && upright(text));
    const boxes = texts.map(text => text.getBoundingClientRect());
    for (let i = 0; i < boxes.length; i++) for (let k = 0; k < i; k++) {
      const [a, b] = [boxes[i], boxes[k]];
      const wide = Math.min(a.right, b.right) - Math.max(a.left, b.left);
      const high = Math.min(a.bottom, b.bottom) - Math.max(a.top, b.top);
      // A box is higher, and where it is upright wider, than its letters.
      const tall = 0.35 * Math.min(a.height, b.height);
      const broad = a.width < a.height ? 0.35 * Math.min(a.width, b.width) : 1;
      if (wide > broad && high > tall) found.push([texts[k].textContent.trim(), texts[i].textContent.trim()]);
    }
  }
  return found;
}"""
OUTSIDE = """() => {
  const width = document.documentElement.clientWidth;
  const cut = [...document.querySelectorAll("p, li, h1, h2, h3, figcaption, img, iframe, .table, .figure, svg text")]
    .filter(e => !(e.closest(".table, .figure") && !e.matches(".table, .figure")))
    .filter(e => { const r = e.getBoundingClientRect(); return r.width > 0 && (r.right > width + 1 || r.left < -1); });
  return cut.map(e => e.tagName + " " + e.textContent.trim().slice(0, 60));
}"""
SMALLEST = """() => Math.min(...[...document.querySelectorAll("svg text")]
  .filter(e => !e.outerHTML.includes("rotate(-"))
  .map(e => e.getBoundingClientRect().height).filter(height => height > 0))"""


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    """The report of the results that are kept, with a picture, and of a contest of a few methods."""
    out = tmp_path_factory.mktemp("report")
    made_up = json.loads((RESULTS / "verification.json").read_text())
    about = {"study": "faces", "question": "", "options": {}, "gates": [], "words": ""}
    lines = [make_line(name, "a", k, seconds=seconds, error=error) for k in range(2) for name, seconds, error in (
        (m.NETWORK, 4e-5, 0.25), (m.DERIVATIVES, 1e-5, 0.15), (m.PD_FIRST_ORDER, 0.2, 0.001), (m.CARRIED, 1e-5, 1.0)
    )]  # fmt: skip
    row = {**made_up["rows"][0], "case": "a", "method": "every method", "values": {"rows": lines}}
    (out / "faces.json").write_text(json.dumps({**made_up, **about, "rows": [row]}))
    for file in sorted(RESULTS.glob("*.json")):
        found = json.loads(file.read_text())
        if found["study"] == "agreement":
            x, triangles = geodesic_sphere(6)
            ball = Surface(90.0 * x, triangles)
            panels = [Panel(name, ball, np.abs(x[:, 0])) for name in ("target", "simulated", "a", "b", "c")]
            (out / "ball.png").write_bytes(draw_strip(panels, size=200))
            found["rows"][0]["values"]["balls"] = "ball.png"
        (out / file.name).write_text(json.dumps(found))
    made = [read_part(file, load_study) for file in sorted(out.glob("*.json"))]
    return write_report(made, out / "report", "the fast simulator, finite elements and the network")[0]


@pytest.mark.parametrize("width", [1400, 390])
def test_nothing_is_cut_off_and_no_text_stands_in_another(browser, page, width):
    tab = browser.new_page(viewport={"width": width, "height": 900})
    tab.goto(page.as_uri())
    assert tab.evaluate("document.documentElement.scrollWidth") <= width
    assert tab.evaluate(OUTSIDE) == []
    assert tab.evaluate(OVERLAPS) == []
    assert tab.evaluate(SMALLEST) >= 9.0  # [px], a line of 7-point letters
    panels = [image.bounding_box() for image in tab.locator(".panels").first.locator("img").all()]
    rows = len({round(box["y"]) for box in panels})
    assert len(panels) == 5 and rows == (1 if width > 600 else 3)
    tab.close()


def test_the_first_screen_has_the_question_answers_and_a_figure(browser, page):
    tab = browser.new_page(viewport={"width": 1400, "height": 900})
    tab.goto(page.as_uri())
    order = tab.evaluate("[...document.querySelectorAll('h1, .answers, figure, h2')].slice(0, 4).map(e => e.tagName)")
    assert order == ["H1", "UL", "FIGURE", "H2"]
    assert 3 <= tab.locator(".answers li").count() <= 5
    assert tab.locator("figure svg").first.bounding_box()["y"] < 500
    # Headings are questions in words.
    assert all(f'<h2 id="{kept.stem}">' in page.read_text() for kept in RESULTS.glob("*.json"))
    headings = tab.locator("h2").all_inner_texts()
    assert len(headings) > 15 and all(text.endswith("?") and len(text.split()) > 3 for text in headings)
    tab.close()
