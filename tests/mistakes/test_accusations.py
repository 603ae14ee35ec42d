"""Nobody is accused of what he did not do: lenses that nobody stated, cameras that stand elsewhere, one face turned."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rig import recording
from tests.bench.accusations import setup
from tests.mistakes.good import recorded
from vision.mistakes import look


@pytest.mark.parametrize("number", [0, 2, 6, 8, 82])
def test_a_lens_that_nobody_stated_is_no_other_mistake(number: int, tmp_path: Path) -> None:
    """Accused before: 0 and 8 of edges 5 mm too large, 2 of distortion with the sign reversed, 6 of twice the focal length, 82 of corners that
    do not agree with rig.toml: one camera sees a single base marker."""
    found = setup(number, tmp_path / "rec")
    assert not found.accused, found


def test_one_face_turned_is_told_as_that(tmp_path: Path) -> None:
    """Said before: the edge of all cubes is stated too small."""
    recorded(tmp_path / "rec")
    read = recording.load(tmp_path / "rec")
    assert read.corners is not None
    turned = read.corners.marker == read.design.targets[0].ids[4]
    (found,) = look(read, replace(read.corners, corner=np.where(turned, (read.corners.corner + 2) % 4, read.corners.corner)), thorough=True)
    assert "face +z of cube P1 (marker 4) is turned by 180 degrees" in found.what
