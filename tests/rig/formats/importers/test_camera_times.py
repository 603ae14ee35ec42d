"""Each camera's own times are kept where commands state how the machine moved between them."""

from decimal import Decimal
from types import SimpleNamespace

import pytest

from rig.formats.importers.exposures_from_image_names import ImportedExposures
from rig.formats.importers.foreign_file_import_recipe import ForeignTable, Images, Recipe
from rig.formats.importers.imported_frame_times_from_names_tables_or_commands import exposures_with_times_and_recipe

COMMANDS = SimpleNamespace(t=[Decimal(0), Decimal(9)])


def timed(tmp_path, offset, commanded, frames=None):
    """(times of two frames of two cameras, remarks)."""
    t = [Decimal(0), Decimal(offset), Decimal(1), Decimal(1) + Decimal(offset)]
    paths = [tmp_path / f"{camera}/{k}.png" for k in (0, 1) for camera in ("a", "b")]
    exposed = ImportedExposures(
        [0, 0, 1, 1], None if frames else t, ["a", "b", "a", "b"], paths, Images((tmp_path,)), ()
    )
    recipe = Recipe(tmp_path / "rig.toml", images=exposed.images, frames=frames)
    found, _ = exposures_with_times_and_recipe(exposed, commanded, recipe, lambda _: True)
    return [float(one) for one in found.times()], " ".join(found.remarks)


@pytest.mark.parametrize(
    "offset, commanded, kept, says",
    [
        ("0.03", COMMANDS, True, "each camera's own times are kept: those of a frame differ by up to 30 ms"),
        ("0.03", None, False, "no commands state how the machine moved"),
        ("0.0005", None, True, "own times are kept"),
        ("0.3", COMMANDS, False, "more than a frame's may"),
    ],
)
def test_own_times_are_kept_where_a_recording_takes_them(tmp_path, offset, commanded, kept, says):
    t, remarks = timed(tmp_path, offset, commanded)
    off = float(offset)
    assert t == pytest.approx([0, off, 1, 1 + off] if kept else [off / 2, off / 2, 1 + off / 2, 1 + off / 2])
    assert says in remarks


def test_a_table_states_times_by_camera(tmp_path):
    (tmp_path / "frames.csv").write_text("frame,camera,t\n0,a,0\n0,b,0.02\n1,a,1\n1,b,1.02\n")
    t, remarks = timed(tmp_path, "0", COMMANDS, ForeignTable(tmp_path / "frames.csv", time_unit="s"))
    assert t == pytest.approx([0, 0.02, 1, 1.02]) and "differ by up to 20 ms" in remarks
