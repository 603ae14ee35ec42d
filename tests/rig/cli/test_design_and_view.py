"""The commands that make and draw rigs, as a user gives them, in a process of their own."""

import json

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from rig.formats.rig_toml import design_from_rig_toml
from rig.model.pose import pose_difference
from rig.recording import corner_and_pose_csv_tables
from tests.cli import Links, run
from tests.conftest import BENCH


def test_a_rig_can_be_designed_simulated_and_measured(tmp_path):
    run("design", "--radius", "0.25", "--cameras", "2", "--size", "800x600", "--out", tmp_path / "rig.toml")
    assert len(design_from_rig_toml.load_design(tmp_path / "rig.toml").cameras) == 2
    done = run(
        "simulate",
        tmp_path / "rig.toml",
        "--plan",
        "sobol:12",
        "--effect",
        "backlash:strut3:gap=4e-5",
        "--noise",
        "0.03",
        "--seed",
        "5",
        "--out",
        tmp_path / "rec",
        "--truth",
        tmp_path / "truth.json",
    )
    assert "12 frames" in done.stdout and "backlash at strut 3" in done.stdout
    truth = json.loads((tmp_path / "truth.json").read_text())
    assert (
        truth["effects"][0]["parameters"] == {"gap": 4e-5} and len(truth["poses"]) == 12 and truth["noise_px"] == 0.03
    )
    run("measure", tmp_path / "rec", "--out", tmp_path / "out")
    poses = corner_and_pose_csv_tables.load_poses(tmp_path / "out" / "poses.csv")
    errors = pose_difference(
        poses.T_base_platform, RigidTransform.from_matrix(np.array(truth["poses"]).reshape(-1, 4, 4))
    )
    assert np.abs(errors[:, :3]).max() < 1e-3


@pytest.mark.parametrize("units", [(), ("--units", "mm,deg")], ids=["m", "mm"])
def test_a_new_design_names_what_drives_it(tmp_path, units):
    rig = tmp_path / "rig.toml"
    run("new", "design", "--radius", "0.25", *units, "--out", rig)
    text = rig.read_text()
    controller = design_from_rig_toml.load_design(rig).driver()
    assert (controller.protocol, controller.port, controller.homing) == ("grblhal", "", True)
    np.testing.assert_allclose(controller.zero, np.zeros(6), atol=0)
    np.testing.assert_allclose(controller.tolerance, 1e-5, rtol=1e-12)
    assert (controller.max_speed > 0).all()
    rig.write_text(text.replace('# port = "/dev/ttyACM0"', 'port = "/dev/ttyACM0"'))  # as its owner completes it
    assert design_from_rig_toml.load_design(rig).driver().port == "/dev/ttyACM0"


@pytest.mark.parametrize(
    "extra, says",
    [
        (("--plan", "sobl"), "no part 'sobl'"),
        (("--effect", "backlsh:3"), "'backlash' meant"),
        (
            ("--effect", "compliance:rig"),
            "at rig has no size and would change nothing: write compliance:rig:stiffness=.., from 1e+06 to 1e+08 N/m",
        ),
        (("--noise", "-1"), "at least 0 and at most 1000 px"),
        (("--images", "--effect", "edge_bias:cameras:bias=0.1"), "not drawn"),
        (("--images", "--bits", "10"), "8 or 12"),
        (("--machine", "nowhere.json"), "no such file"),
    ],
)
def test_what_cannot_be_simulated_is_said_and_leaves_nothing(tmp_path, rig_text, extra, says):
    (tmp_path / "rig.toml").write_text(rig_text)
    assert says in run("simulate", tmp_path / "rig.toml", *extra, "--out", tmp_path / "rec", ok=False).stderr
    assert not (tmp_path / "rec").exists()


def test_a_frame_is_drawn(tmp_path):
    done = run("view", BENCH / "check", "--frame", "2", "--out", tmp_path / "v.png")
    import cv2

    picture = cv2.imread(str(tmp_path / "v.png"))
    assert picture.shape == (384, 3 * 484, 3) and "platform at" in done.stdout and "residual" in done.stdout
    colours = {tuple(c) for c in picture.reshape(-1, 3)[::7].tolist()}
    assert any(g > 150 and r < 130 and b < 130 for b, g, r in colours)  # markers are outlined in green
    assert "no frame 77" in run("view", BENCH / "check", "--frame", "77", "--out", tmp_path / "v.png", ok=False).stderr


@pytest.mark.slow
def test_nets_are_true_to_scale(tmp_path):
    """The sheet is rasterised and its markers read back: the black border's side and the page are as stated."""
    run("design", "--radius", "0.15", "--cubes", "2", "--out", tmp_path / "rig.toml")
    done = run("print", tmp_path / "rig.toml", "--out", tmp_path / "s.pdf")
    design = design_from_rig_toml.load_design(tmp_path / "rig.toml")
    assert (tmp_path / "s.pdf").read_bytes().startswith(b"%PDF") and "assembly: A4" in done.stdout
    import cv2
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    from synthetic import printable_target_sheets as print_sheets

    target = design.targets[0]
    (page,) = print_sheets.sheets_of_target(target, "A3")
    figure, axes = print_sheets.blank_sheet_figure_and_axes(page.paper)
    figure.set_dpi(254)  # 10 px to the millimetre
    FigureCanvasAgg(figure)
    print_sheets.draw_sheet(axes, page)
    figure.canvas.draw()
    grey = np.asarray(figure.canvas.buffer_rgba())[..., 0]
    assert abs(grey.shape[1] / 10 - page.paper[0]) < 0.2
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, target.dictionary))
    corners, ids, _ = cv2.aruco.ArucoDetector(dictionary).detectMarkers(np.ascontiguousarray(grey))
    assert sorted(ids.ravel().tolist()) == sorted(target.ids)
    places = {}
    for number, quad in zip(ids.ravel().tolist(), corners):
        sides = np.linalg.norm(np.roll(quad[0], -1, axis=0) - quad[0], axis=1)
        np.testing.assert_allclose(sides / 10, target.marker * 1e3, atol=0.35)
        assert quad[0][0][1] < quad[0][2][1] and quad[0][0][0] < quad[0][1][0]  # every face stands upright in the net
        places[dict((n, f) for f, n in target.faces)[number]] = quad[0].mean(axis=0) / 10
    edge = target.edge * 1e3
    np.testing.assert_allclose(
        places["+y"] - places["+x"], [edge, 0], atol=0.3
    )  # right of +x, seen from outside, lies +y
    np.testing.assert_allclose(places["+z"] - places["-y"], [0, -edge], atol=0.3)


@pytest.mark.slow
def test_lens_prints_a_camera_that_a_rig_takes(shared, tmp_path):
    photographs = shared / "photos" / "charuco"
    wanted = [photographs / f"{name}.png" for name in ("01", "03", "05", "10", "11")]
    (tmp_path / "grey.png").write_bytes((photographs / "01.png").read_bytes())
    import cv2

    cv2.imwrite(str(tmp_path / "grey.png"), np.full((1200, 1600), 90, np.uint8))
    done = run(
        "lens",
        *wanted,
        tmp_path / "grey.png",
        "--board",
        "charuco:5x7:0.036195:0.018256:DICT_6X6_250",
        "--out",
        tmp_path / "out",
    )
    assert "grey.png: the board is not found in it" in done.stderr and "5 of 6 photographs" in done.stderr
    rig = tmp_path / "rig.toml"
    rig.write_text('schema = "rig/1"\n[mechanism]\nkind = "free"\n' + done.stdout)
    camera = design_from_rig_toml.load_design(rig).cameras[0]
    assert camera.name == "cam0" and camera.width == 1600 and 1300 < camera.matrix[0, 0] < 1450
    assert (tmp_path / "out" / "camera.toml").read_text() == done.stdout
    links = Links()
    links.feed((tmp_path / "out" / "lens.html").read_text())
    assert not links.outside


def test_lens_says_what_it_cannot_use(tmp_path):
    import cv2

    board = "charuco:5x7:0.036195:0.018256:DICT_6X6_250"
    assert "no such file" in run("lens", tmp_path / "nothing", "--board", board, ok=False).stderr
    assert "no photographs in this folder" in run("lens", tmp_path, "--board", board, ok=False).stderr
    assert "no dictionary" in run("lens", tmp_path, "--board", board[:-1], ok=False).stderr
    (tmp_path / "broken.png").write_bytes(b"\x89PNG")
    assert "broken.png: contains no image of readable size" in run("lens", tmp_path, "--board", board, ok=False).stderr
    cv2.imwrite(str(tmp_path / "broken.png"), np.zeros((40, 60), np.uint8))
    nothing = run("lens", tmp_path, "--board", board, ok=False).stderr
    assert "0 photographs show" in nothing and "broken.png: the board is not found" in nothing
    cv2.imwrite(str(tmp_path / "other.png"), np.zeros((40, 50), np.uint8))
    assert "all images of a camera have the same size" in run("lens", tmp_path, "--board", board, ok=False).stderr
