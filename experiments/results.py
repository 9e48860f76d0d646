"""What an experiment found: its table on the screen, and with every single log in its folder."""

import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any


def tell(folder: Path, name: str, said: str, text: str, rows: Sequence[Any]) -> None:
    """Print a table, and write it below what is `said` of it (name.md) and the dataclasses behind it (name.json)."""
    print(text)
    (folder / f"{name}.md").write_text(f"{said}\n\n{text}\n")
    (folder / f"{name}.json").write_text(json.dumps([asdict(x) for x in rows], indent=1) + "\n")
