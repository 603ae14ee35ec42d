"""A JSON file of ours -> Entries that check what they hand out; every complaint names the file and the key."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rig.errors import FileError
from rig.outside import read_text, shown
from rig.schema import require

if TYPE_CHECKING:
    from rig.entries import Entries

LARGEST = 1 << 26  # bytes


def load(path: Path, what: str, *schemas: str) -> Entries:
    """The table that a JSON file holds. what : it should be, as in "calibration"; schemas : of which it must name one; none for any.

    Raises FileError for a file that is missing, cut off, no JSON, nested too deep or of another schema
    """
    from rig.entries import Entries

    path = Path(path)
    text = read_text(path, LARGEST)
    try:
        tree = json.loads(text)
    except json.JSONDecodeError as error:
        raise FileError(path, f"not valid JSON: {error.msg} (cut off?)", error.lineno, error.colno) from None
    except RecursionError:
        raise FileError(path, "not valid JSON: nested too deep") from None
    except ValueError as error:  # a number that is none, or of thousands of digits
        raise FileError(path, f"not valid JSON: {error}") from None
    if not isinstance(tree, dict):
        raise FileError(path, f"is no {what}: it holds {shown(tree)}")
    if schemas:
        require(path, what, tree.get("schema"), schemas, _place(text, "schema"))
    return Entries(tree, (), path, {(): (None, None)})


def _place(text: str, key: str) -> tuple[int, int] | tuple[None, None]:
    """(line, column) of what stands first under a key in a JSON text; of none, None."""
    found = re.search(rf'"{key}"\s*:\s*', text)
    if found is None:
        return None, None
    before = text[: found.end()]
    return before.count("\n") + 1, found.end() - before.rfind("\n")


def nulls(tree: Any) -> Any:
    """The same with null for figures of what was not measured: JSON has no NaN."""
    if isinstance(tree, dict):
        return {name: nulls(value) for name, value in tree.items()}
    if isinstance(tree, list | tuple):
        return [nulls(value) for value in tree]
    return None if isinstance(tree, float) and not math.isfinite(tree) else tree
