"""A head sealed at mouth and lids, turned and in inches, opens mouth and eyes as the template."""

import numpy as np

from softdeca.lhm import Surface, check_head, identities, load_template, scans
from softdeca.lhm.base.geometry.topology import close_openings
from softdeca.lhm.identities.arkit import ARKIT
from softdeca.lhm.identities.gaps import find_gaps
from softdeca.lhm.identities.space import EYES, MOUTH

from ..robustness.whole_files import grouped_obj

TURNED = np.array([[0, 0, 1.0], [1, 0, 0], [0, 1, 0]])  # z up, x the front


def test_a_sealed_head_is_fitted_and_opens_mouth_and_eyes(data, tmp_path):
    space = identities.from_text(f"ict:{data / 'ict_facekit.npz'}")
    skin, hidden = space.mean, np.isin(space.parts, (MOUTH, EYES))[space.mean.triangles].any(axis=1)
    shut = space.expressions[[ARKIT.index(f"eyeBlink{side}") for side in ("Left", "Right")]].sum(axis=0)
    scan = close_openings(Surface(skin.vertices + shut, skin.triangles[~hidden]))
    path = tmp_path / "head.obj"
    path.write_text(grouped_obj(scan.vertices @ TURNED.T / 25.4, scan.triangles, 9))
    template = load_template(level=1)
    head = scans.fit_scan(template, path)
    assert any("taken for in" in note for note in head.notes), head.notes
    assert any("z is up, x the front" in note for note in head.notes), head.notes
    assert np.array_equal(head.skin.triangles, template.skin.triangles)
    assert check_head(head).problems == ()
    # Lids meet: the rims are as near to one another as the template's.
    gaps = [shut_gap(template, each) for each in (template.space.mean, head.skin)]
    assert gaps[1] < gaps[0] + 0.5, gaps


def shut_gap(template, skin):
    """The mean distance [mm] of the upper lids' rims from the lower, both blinks at full weight."""
    shapes = template.space.shapes_on(skin)
    x = skin.vertices + shapes[[ARKIT.index(f"eyeBlink{side}") for side in ("Left", "Right")]].sum(axis=0)
    gaps = find_gaps(template.space.mean, template.parts, template.space.expressions)
    lids = [np.linalg.norm(x[gap.upper] - x[gap.lower], axis=1).mean() for gap in gaps if "lids" in gap.name]
    return float(np.mean(lids))
