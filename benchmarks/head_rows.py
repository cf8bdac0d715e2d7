"""The rows of a campaign over many heads: one line of JSON per head, appended as heads are done."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

from ..lhm.errors import InputError
from ..lhm.files.atomic import write_whole


class HeadRows:
    """Rows by seed in FOLDER/heads.jsonl, all of one campaign, which FOLDER/campaign.json describes.

    A line that is torn, as a kill or a full disk leaves the last one, is dropped when the file is opened, so its head
    is done again. Raises InputError if the folder holds rows of another campaign.
    """

    def __init__(self, folder: Path, campaign: Mapping[str, object]):
        self.path = folder / "heads.jsonl"
        self._hold(folder / "campaign.json", dict(campaign))
        content = self.path.read_bytes() if self.path.exists() else b""
        lines = content.split(b"\n")
        rows = [(line, _row(line)) for line in lines[:-1]]
        self.by_seed: dict[int, dict] = {row["seed"]: row for _, row in rows if row is not None}
        if lines[-1] or any(row is None for _, row in rows):
            write_whole(self.path, b"".join(line + b"\n" for line, row in rows if row is not None))

    def append(self, row: dict) -> None:
        """Add one head's row, which has its `seed`."""
        with open(self.path, "a") as file:
            file.write(json.dumps(row, allow_nan=False) + "\n")
        self.by_seed[row["seed"]] = row

    @staticmethod
    def _hold(path: Path, campaign: dict) -> None:
        if not path.exists():
            write_whole(path, json.dumps(campaign, indent=1).encode())
            return
        try:
            found = json.loads(path.read_text())
        except ValueError:
            found = None
        if not isinstance(found, dict):
            raise InputError(f"{path}: damaged, or not of softdeca; use another folder")
        for key, value in campaign.items():
            if found.get(key) != value:
                raise InputError(
                    f"{path.parent}: holds heads of another {key} ({found.get(key)}, expected {value}); "
                    "use another folder"
                )


def _row(line: bytes) -> dict | None:
    try:
        row = json.loads(line)
    except ValueError:
        return None
    return row if isinstance(row, dict) and isinstance(row.get("seed"), int) else None
