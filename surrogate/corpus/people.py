"""People by name, as a command line has them."""

from __future__ import annotations

from functools import partial

from ...lhm import fit_head, identities, load_template
from ...lhm.base.errors import InputError
from ...lhm.base.progress import OnProgress, silent
from ...lhm.template import DEFAULT_LEVEL
from ..sphere import Spheres
from .person import OfSpace, People


def people_of(text: str, *, level: int = DEFAULT_LEVEL, on_progress: OnProgress = silent) -> People:
    """The people of "anny", "ict:FILE", "flame:FILE" or "folder:DIR", with heads of the template at a level.

    "external:SPACE" are those of another space in the default's triangles, with shapes of their own: see `external`.
    "spheres:N" are layered spheres of N subdivisions, 1 to 4, which cost nothing: see `sphere`.

    InputError for another text.
    """
    kind, _, other = text.partition(":")
    if kind == "spheres":
        if other not in ("1", "2", "3", "4"):
            raise InputError(f"identities {text!r}: expected 'spheres:' and 1 to 4 subdivisions")
        spheres = Spheres(int(other))
        return OfSpace(spheres, spheres.mean, spheres.fit)
    if kind == "external":
        from .external import External

        if not other:
            raise InputError(f"identities {text!r}: expected 'external:' and a space, as 'external:ict:FILE'")
        return External.of(identities.from_text(other), level=level, on_progress=on_progress)
    space = identities.from_text(text)
    template = load_template(space, level=level, progress=on_progress)
    return OfSpace(space, space.mean, partial(fit_head, template), template.digest)
