"""A JSON file of ours -> Entries that check what they hand out; every complaint names the file and the key."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rig.errors import FileError
from rig.formats.input_files import read_text, value_text
from rig.formats.json_positions import LARGEST as LOOKED_THROUGH
from rig.formats.json_positions import Places, RepeatedKey, pairs, repeated_key
from rig.formats.schema_version import require_schema

if TYPE_CHECKING:
    from rig.formats.checked_entries import Entries

LARGEST = 1 << 26  # bytes


def load(path: Path, what: str, *schemas: str) -> Entries:
    """The table that a JSON file holds. what : it should be, as in "calibration"; schemas : of which it must name one;
    none for any.

    Raises FileError for a file that is missing, cut off, no JSON, nested too deep, of another schema, or with a key
        twice in one table
    """
    from rig.formats.checked_entries import Entries

    path = Path(path)
    text = read_text(path, LARGEST)
    try:
        tree = json.loads(text, object_pairs_hook=pairs)
    except RepeatedKey:
        key, place = (repeated_key(text) if len(text) <= LOOKED_THROUGH else None) or ("some key", (None, None))
        raise FileError(path, f"key {value_text(key)} is there twice in one table: which holds?", *place, key) from None
    except json.JSONDecodeError as error:
        raise FileError(path, f"not valid JSON: {error.msg} (cut off?)", error.lineno, error.colno) from None
    except RecursionError:
        raise FileError(path, "not valid JSON: nested too deep") from None
    except ValueError as error:  # a number that is none, or of thousands of digits
        raise FileError(path, f"not valid JSON: {error}") from None
    if not isinstance(tree, dict):
        raise FileError(path, f"is no {what}: it holds {value_text(tree)}")
    places = Places(text)
    if schemas:
        require_schema(path, what, tree.get("schema"), schemas, places.get(("schema",), (None, None)))
    return Entries(tree, (), path, places)


def nan_to_null(tree: Any) -> Any:
    """The same with null for figures of what was not measured: JSON has no NaN."""
    if isinstance(tree, dict):
        return {name: nan_to_null(value) for name, value in tree.items()}
    if isinstance(tree, list | tuple):
        return [nan_to_null(value) for value in tree]
    return None if isinstance(tree, float) and not math.isfinite(tree) else tree
