"""The diagrams of which folder imports which: counted, layered, and without a folder or an upward import that is not
shown.
"""

import re
import xml.etree.ElementTree as ET

import pytest

from docs.make import dependency_diagram
from docs.make.imports_between_folders import downward, folder_counts, layers, names, order, package_counts, unimplied

SVG = "{http://www.w3.org/2000/svg}"
CHAIN = {("a", "b"): 3, ("b", "c"): 2, ("a", "c"): 5, ("c", "b"): 1}  # c -> b runs against the others


def test_few_imports_run_against_the_order():
    assert order(CHAIN) == ["a", "b", "c"] and layers(CHAIN) == {"a": 2, "b": 1, "c": 0}
    assert downward(CHAIN) == {("a", "b"): 3, ("b", "c"): 2, ("a", "c"): 5}
    assert unimplied(CHAIN) == {("a", "b"): 3, ("b", "c"): 2}


def test_the_packages_stand_as_the_contract_has_them():
    level = layers(package_counts())
    assert (
        level["rig/cli"] > level["calib"] > level["vision"] > level["rig"] == 0
        and level["rig/cli"] > level["synthetic"] > level["vision"]
    )
    assert not {("calib", "synthetic"), ("synthetic", "calib")} & set(package_counts())
    assert downward(package_counts()) == package_counts()


@pytest.mark.slow
@pytest.mark.parametrize("name", dependency_diagram.DIAGRAMS)
def test_every_folder_and_every_upward_import_is_drawn_within_the_frame(name):
    counts = package_counts() if name == "packages" else folder_counts(name)
    root = ET.fromstring(dependency_diagram.diagram(name))
    titles = [title.text for title in root.iter(f"{SVG}title")]
    assert all(any(text.startswith(f"{folder} imports ") for text in titles) for folder in names(counts))
    upward = [pair for pair in counts if pair not in downward(counts)]
    assert all(f"{a} imports {b}, upward ({counts[a, b]})" in titles for a, b in upward)
    assert sum(path.get("class") == "against" for path in root.iter(f"{SVG}path")) == len(upward)
    wide, high = (float(root.get(key)) for key in ("width", "height"))
    boxes = [
        [float(box.get(key)) for key in ("x", "y", "width", "height")]
        for box in root.iter(f"{SVG}rect")
        if box.get("x")
    ]
    assert len(boxes) == len(names(counts)) and all(
        x > 0 and x + w < wide and y > 0 and y + h < high for x, y, w, h in boxes
    )
    apart = [
        abs(x - u) >= min(w, p) or abs(y - v) >= h for k, (x, y, w, h) in enumerate(boxes) for u, v, p, _ in boxes[:k]
    ]
    assert all(apart) and not re.search(r"https?://(?!www\.w3\.org/2000/svg)", ET.tostring(root, encoding="unicode"))
