"""Heads cut at the neck, without lining of mouth and eyes, turned and in inches: fitted, and as open as they were."""

import numpy as np
import pytest

from softdeca.lhm import Surface, check_head, identities, load_template, scans
from softdeca.lhm.arkit import ARKIT
from softdeca.lhm.base.geometry.topology import close_openings, find_openings
from softdeca.lhm.identities.space import EYES, MOUTH, OUTSIDE
from softdeca.lhm.scans.eyes import SIDES

from ..robustness.whole_files import grouped_obj

TURNED = np.array([[0, 0, 1.0], [1, 0, 0], [0, 1, 0]])  # z up, x the front


@pytest.mark.parametrize("name", ["anny", "ict"])
def test_a_rigs_open_head_is_fitted_and_stays_open(name, request, tmp_path):
    text = "anny" if name == "anny" else f"ict:{request.getfixturevalue('data') / 'ict_facekit.npz'}"
    space = identities.from_text(text)
    skin, corners = space.mean, space.parts[space.mean.triangles]
    visible = ~np.isin(corners, (MOUTH, EYES)).any(axis=1)
    low = np.quantile(skin.vertices[space.parts == OUTSIDE, 1], 0.03)
    kept = skin.triangles[visible & (skin.vertices[skin.triangles][:, :, 1] > low).all(axis=1)]
    path = tmp_path / "head.obj"
    path.write_text(grouped_obj(skin.vertices @ TURNED.T / 25.4, kept, 9))
    head = scans.fit_scan(path, load_template(level=1))
    assert any("taken for in" in note for note in head.notes), head.notes
    assert any("z is up, x the front" in note for note in head.notes), head.notes
    assert len(head.skin.vertices) == len(np.unique(kept))
    # Neck, mouth and two eyes.
    assert len(find_openings(head.skin.triangles)) == len(find_openings(kept)) >= 4
    assert check_head(head).problems == ()
    assert not any("sealed" in note or "closed" in note for note in head.notes), head.notes


def test_a_head_sealed_at_mouth_and_lids_is_opened_and_says_what_stays_still(data, tmp_path):
    space = identities.from_text(f"ict:{data / 'ict_facekit.npz'}")
    drawn = space.mean.vertices + space.expressions[[ARKIT.index(f"eyeBlink{side}") for side in SIDES]].sum(axis=0)
    hidden = np.isin(space.parts, (MOUTH, EYES))[space.mean.triangles].any(axis=1)
    skin = close_openings(Surface(drawn, space.mean.triangles[~hidden]))
    path = tmp_path / "head.obj"
    path.write_text(grouped_obj(skin.vertices @ TURNED.T / 10, skin.triangles, 3))
    head = scans.fit_scan(path, load_template(level=1))
    assert any("mouth: sealed; opened" in note for note in head.notes), head.notes
    assert any(note.startswith("eyes: closed") for note in head.notes), head.notes
    report = check_head(head)
    # Each vertex with the motion of its closest point had 322 mm of folds at the mouth's corners.
    assert report.problems == () and report.jaw_open_torn < 400 and report.jaw_open_folded < 95
    assert {"eyeBlinkLeft", "eyeWideRight"} <= set(head.rig.doubtful)
