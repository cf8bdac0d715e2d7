"""Takes read from LiveLink Face's CSV, a recorder's weights.csv, or JSON."""

from __future__ import annotations

import os
from pathlib import Path

from ..base.checks import check_arguments
from ..base.errors import InputError
from ..base.files.text import read_bytes
from ..base.limits import TAKE_BYTES
from .livelink import parse_csv
from .take import Take
from .take_json import parse_json
from .weights_csv import is_transposed, parse_transposed


@check_arguments
def read_take(path: str | os.PathLike[str]) -> Take:
    """A take from a CSV of LiveLink Face (`livelink`) or of a row per quantity (`weights_csv`), or JSON (`take_json`).

    By its suffix, and a CSV by what it holds. Values outside [0, 1] are clipped and counted, frames without a face left
    out and counted, expressions that the file lacks are zero and named: all stand in the Take. Raises InputError, one
    line that names the file and, where there are such, line or frame and column.
    """
    parsers = {".csv": parse_csv, ".json": parse_json}
    path = Path(path)
    parse = parsers.get(path.suffix.lower())
    if parse is None:
        raise InputError(f"{path}: unknown kind of file; expected one of {', '.join(parsers)}")
    content = read_bytes(path, TAKE_BYTES)
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise InputError(f"{path}: cannot be read (it is no text)") from None
    if not text.strip():
        raise InputError(f"{path}: the file is empty")
    if parse is parse_csv and is_transposed(text):
        parse = parse_transposed
    try:
        return parse(text)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
