"""Heads with one thing odd: `head check` tells it; a simulation of a damaged file ends before it begins."""

from dataclasses import replace

import numpy as np
import pytest

from softdeca.lhm import check_head, identities, load_template
from softdeca.lhm.expressions.rig import Rig
from softdeca.lhm.head.file import load_head, save_head
from softdeca.lhm.template.file import read_template, save_template
from softdeca.lhm.template.fit import fit_head

from ..refusals import refused


@pytest.fixture(scope="module")
def head():
    return fit_head(load_template(level=1), identities.Anny().mean)


def rigged(change):
    return lambda head: replace(head, rig=Rig(change(head.rig.deltas), ""))


TOLD = {
    "rig negated": (rigged(lambda deltas: -deltas), "jaw drop: -"),
    "rig of expressions in another order": (rigged(np.random.default_rng(0).permutation), "own side: "),
    "rig mirrored": (rigged(lambda deltas: deltas * [-1, 1, 1]), "sideways: -"),
}


@pytest.mark.parametrize("name", TOLD)
def test_a_head_that_is_odd_is_told_by_check(tmp_path, head, command, name):
    change, words = TOLD[name]
    path = tmp_path / "odd.npz"
    save_head(path, change(head))
    problems = check_head(load_head(path)).problems
    assert any(words in problem for problem in problems), problems
    ended = command("head", "check", path)
    assert ended.status == 1 and ended.errors[-1].startswith("softdeca: error")


def test_regions_that_a_face_lacks_are_counted(head):
    fewer = {name: mask for name, mask in head.regions.items() if name not in ("lids", "ears")}
    lacking = replace(head, regions=fewer | {"teeth": head.regions["teeth"] & False})
    assert [check_head(each).regions_unknown for each in (head, lacking)] == [0, 3]


def test_a_template_survives_the_file_and_a_damaged_one_is_refused(tmp_path):
    path, template = tmp_path / "template.npz", load_template(level=1)
    save_template(path, template)
    again = read_template(path)
    assert again.name == template.name and again.digest == template.digest and again.space is again.regressor is None
    assert (
        again.skin_from_wrap != template.skin_from_wrap
    ).nnz == 0 and again.regions.keys() == template.regions.keys()
    np.savez(path, **dict(np.load(path)) | {"stack": template.stack[:-1]})
    refused("template.npz: damaged, its checksum is another; make the template again", read_template, path)
