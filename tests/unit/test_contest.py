"""The contest of methods on faces: rows in long form, and pairs of error and seconds on the first screen."""

from dataclasses import replace

import numpy as np
import pytest

from softdeca.benchmarks.contest import Case, run_contest, summarise
from softdeca.benchmarks.harness import first_screen
from softdeca.lhm.base.errors import InputError
from softdeca.reference import Face, Parameters
from softdeca.surrogate import methods as m

from ..conftest import layered_sphere, with_regions


def refuse(face):
    raise InputError("it never binds")


def make_case(made):
    head = with_regions(layered_sphere(3))
    skin = head.skin.vertices
    shapes = np.zeros((52, *skin.shape))
    shapes[:, :, 2] = 3.0 * np.maximum(skin[:, 2], 0.0) / np.abs(skin).max()

    def make():
        made.append(1)
        return Face(head, shapes, Parameters(soft_volume=1.2), per="wraps")

    weights = np.zeros((2, 52))
    weights[0, 0], weights[1, 1] = 0.5, 0.8
    return Case("a sphere", "volume", make, weights, head_s=0.25)


def test_every_method_has_a_fresh_face_and_a_failure_is_a_row():
    made = []
    refused = m.Method("refused", refuse)
    case = make_case(made)
    rows = run_contest(case, [m.PD_TETS, m.SETTLED, m.BLENDSHAPES, refused], [m.PD], warm=replace(case, name="warm"))
    assert len(made) == 2 * 5 + 1  # each method's, warm and timed, and the one that measures
    assert [row["method"] for row in rows] == [name for name in (m.PD, m.PD_TETS, m.SETTLED, m.BLENDSHAPES, "refused")
                                               for _ in range(2)]  # fmt: skip
    failed = [row for row in rows if row["status"] != "done"]
    assert {row["method"] for row in failed} == {"refused"} and failed[0]["reason"] == "it never binds"
    assert not failed[0]["to"] and failed[0]["frame_s"] is None
    done = {(row["method"], row["frame"]): row for row in rows if row["status"] == "done"}
    assert done[m.PD, 0]["cells"] == "prisms" and done[m.PD_TETS, 0]["cells"] == "tets"
    assert done[m.PD, 0]["told"]["iterations"] > 0 and not done[m.PD, 0]["to"]
    assert done[m.PD, 0]["head_s"] == 0.25 and done[m.BLENDSHAPES, 0]["head_s"] == 0.0
    found = summarise(rows, "method", m.PD)
    assert found[m.BLENDSHAPES].share == pytest.approx(1.0) and 0.0 < found[m.SETTLED].share < 1.0
    assert found[m.SETTLED].frames == {("a sphere", 0), ("a sphere", 1)}


def make_line(method, case, frame, *, seconds, error, truth=m.PD, cells="prisms"):
    to = {} if error is None else {truth: {"mean": error, "p95": error, "largest": error, "moved": 1.0, "share": error,
                                           "vertices": 10, "everywhere": error, "farthest": error}}  # fmt: skip
    return {"case": case, "kind": "default", "method": method, "cells": cells, "frame": frame, "status": "done",
            "reason": "", "head_s": 0.0, "bind_s": 1.0, "frame_s": seconds, "compile_s": 0.0, "told": {},
            "to": to}  # fmt: skip


def test_each_error_of_the_first_screen_stands_beside_the_seconds_of_its_own_frames():
    lines = [make_line(m.DERIVATIVES, case, frame, seconds=10.0**-frame, error=0.1 * (1 + frame))
             for case in "ab" for frame in range(3)]  # fmt: skip
    shown = first_screen.summarise_own(lines)[m.DERIVATIVES]
    assert shown.frame == pytest.approx(0.1) and shown.share == pytest.approx(0.2) and len(shown.frames) == 6
    # The seconds of another experiment, whose frames have no error, change no pair; an error without seconds has none.
    other = [make_line(m.DERIVATIVES, "default p", 0, seconds=1e3, error=None)]
    assert first_screen.summarise_own(lines + other)[m.DERIVATIVES] == shown
    swapped = [*lines[:5], {**lines[5], "frame_s": None}]
    assert np.isnan(first_screen.summarise_own(swapped)[m.DERIVATIVES].frame)
    (table,) = first_screen.tabulate(lines + other)
    assert table.rows[0][2] == pytest.approx(shown.share) and table.rows[0][5:] == (shown.frame, 6)


def test_advice_names_the_front_of_error_and_time_whoever_is_on_it():
    lines = [make_line(name, "a", 0, seconds=seconds, error=error) for name, seconds, error in (
        (m.BLENDSHAPES, 1e-5, 1.0), (m.NETWORK, 4e-5, 0.25), (m.DERIVATIVES, 1e-5, 0.15), (m.PD_FIRST_ORDER, 0.2, 0.001)
    )]  # fmt: skip
    found = first_screen.summarise_own(lines)
    assert first_screen.find_front(found, "frame") == [m.DERIVATIVES, m.PD_FIRST_ORDER]
    assert f"For many frames of a face pick {m.DERIVATIVES}" in " ".join(first_screen.write_sentences(lines))


@pytest.mark.parametrize(("own", "far", "larger"), [(0.2, 0.1, "network"), (0.1, 0.2, "simulator")])
def test_the_first_screen_tells_whose_error_is_the_larger_on_the_same_frames(own, far, larger):
    lines = []
    for frame, factor in enumerate((0.5, 1.5)):
        network = make_line(m.NETWORK, "a", frame, seconds=1e-5, error=factor * own)
        network["to"][m.FENICSX_P2] = network["to"][m.PD]
        lines += [network, make_line(m.PD, "a", frame, seconds=1.0, error=factor * far, truth=m.FENICSX_P2)]
    other = make_line(m.NETWORK, "b", 0, seconds=1e-5, error=9.0)  # which nobody has converged
    told = first_screen.tell_larger([*lines, other])
    assert told.startswith("On 2 frames of 1 face the network misses") and told.endswith(
        f"the {larger}'s error is the larger."
    )
    assert told in first_screen.write_sentences(lines) and not first_screen.tell_larger([*lines[1:], other])
