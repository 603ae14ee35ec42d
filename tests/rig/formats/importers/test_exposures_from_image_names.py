"""Names of images tell camera, frame and time; exposures of several cameras are grouped by time; what can be both is
refused.
"""

import pytest

from rig.errors import RigError
from rig.formats.importers import exposures_from_image_names
from rig.formats.importers.foreign_file_import_recipe import Images
from tests.rig.formats.importers.foreign import EPOCH

ANY = lambda t: True  # noqa: E731


def scan(folder, design, files, **stated):
    for name in files:
        path = folder / "in" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(b"")
    images = Images((folder / "in",), **stated)
    return exposures_from_image_names.group_images_into_exposures(
        exposures_from_image_names.list_image_files(images, design), images, ANY
    )


@pytest.mark.parametrize(
    "pattern, stated",
    [
        ("cam{c}/{k:05d}.png", {}),
        ("{k}_CAM{c}.JPG", {}),
        ("cam{c}-{k}.tiff", {}),
        ("session7/left{c}/img{k}.png", dict(cameras=(("left0", "cam0"), ("left1", "cam1")))),
        ("run2_cam{c}_f{k}.png", dict(names="run*_{camera}_f{frame}")),
    ],
)
def test_numbers_in_names(pattern, stated, design, tmp_path):
    found = scan(tmp_path, design, [pattern.format(c=c, k=k) for c in (0, 1) for k in (9, 10, 11)], **stated)
    assert found.frame == [9, 9, 10, 10, 11, 11] and found.camera == ["cam0", "cam1"] * 3 and found.t is None


@pytest.mark.parametrize(
    "text", [lambda t: f"{t * 1000:.0f}", lambda t: f"{t:.6f}", lambda t: f"{t * 10**9:.0f}"], ids=["ms", "s", "ns"]
)
def test_times_in_names_are_grouped_across_cameras(text, design, tmp_path):
    at = [EPOCH + k for k in range(3)]
    found = scan(tmp_path, design, [f"cam{c}_{text(t + c * EPOCH.from_float(0.008))}.png" for t in at for c in (0, 1)])
    assert found.frame == [0, 0, 1, 1, 2, 2] and found.camera == ["cam0", "cam1"] * 3
    assert [float(t - EPOCH) for t in found.t] == pytest.approx([0, 0.008, 1, 1.008, 2, 2.008], abs=1e-6)
    assert "the widest 8 ms" in found.remarks[-1] and found.images.tolerance == exposures_from_image_names.LONGEST


def test_exposures_neither_together_nor_apart_are_refused(design, tmp_path):
    names = [f"cam{c}_{(EPOCH + k) * 1000 + 200 * c:.0f}.png" for k in range(3) for c in (0, 1)]
    with pytest.raises(RigError, match=r"yes: --set 'images.tolerance=0.202'\n  no: --set 'images.tolerance=0.02'"):
        scan(tmp_path, design, names)
    assert scan(tmp_path, design, names, tolerance=0.202).frame == [0, 0, 1, 1, 2, 2]
    assert scan(tmp_path, design, names, tolerance=0.02).frame == [0, 1, 2, 3, 4, 5]
    with pytest.raises(RigError, match="camera cam0 has several images"):
        scan(tmp_path, design, names, tolerance=1.5)


@pytest.mark.parametrize(
    "names, says",
    [
        (["cam0_1_2.png"], "which figure"),
        (["cam0_a.png"], "neither frame nor time"),
        (["left_1.png"], "which camera"),
        (["cam0_1.png", "a/cam0_1.png"], "is frame 1 of camera cam0"),
        (["cam0/x.txt"], "no images"),
    ],
)
def test_names_that_do_not_tell_are_refused(names, says, design, tmp_path):
    with pytest.raises(RigError, match=says):
        scan(tmp_path, design, names)


def test_the_settings_offered_for_two_figures_work(design, tmp_path):
    with pytest.raises(RigError) as error:
        scan(tmp_path, design, ["cam0_run3_17.png"])
    offered = [line.split("images.names=")[1].rstrip("'") for line in str(error.value).splitlines()[1:]]
    found = [
        exposures_from_image_names.list_image_files(Images((tmp_path / "in",), names), design)[0] for names in offered
    ]
    assert [(one.frame, one.stamp) for one in found] == [(3, None), (17, None), (None, "3"), (None, "17")]
