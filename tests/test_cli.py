"""The commands as a user gives them, in a process of their own."""

import json
import os
import pty
import re
import shutil
import subprocess
import sys
import termios
from html.parser import HTMLParser

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from rig import design_file, recording, writing
from rig.mechanisms import hexapod
from rig.pose import difference
from tests.conftest import BENCH, make_recording

RIG = [sys.executable, "-c", "import sys; from rig.cli import main; sys.exit(main())"]


def run(*arguments, ok=True):
    done = subprocess.run([*RIG, *map(str, arguments)], capture_output=True, text=True, timeout=300)
    assert "Traceback" not in done.stderr, done.stderr
    assert (done.returncode == 0) == ok, done.stdout + done.stderr
    return done


@pytest.fixture(scope="module")
def worked(tmp_path_factory, design, rig_text):
    """A fit and a check recording of one machine, measured, calibrated: what most commands start from."""
    base = tmp_path_factory.mktemp("worked")
    secret, _ = make_recording(base / "fit", design, rig_text, 7, count=60)
    make_recording(base / "check", design, rig_text, 7, count=20)
    run("measure", base / "fit", "--out", base / "measured")
    run("calibrate", base / "fit", "--out", base / "calibration.json")
    return base, secret


class Links(HTMLParser):
    def __init__(self):
        super().__init__()
        self.outside = []

    def handle_starttag(self, tag, attrs):
        self.outside += [v for k, v in attrs if k in ("src", "href") and not v.startswith("data:")]


def test_measure_writes_what_the_contract_says(worked):
    base, _ = worked
    out = base / "measured"
    header = (out / "poses.csv").read_text().splitlines()[0].split(",")
    assert header[:7] == ["frame", "x", "y", "z", "rx", "ry", "rz"] and header[7:] == list(recording.COVARIANCE_COLUMNS)
    assert (out / "corners.csv").read_text().splitlines()[0].startswith("frame,camera,marker,corner,u,v,sigma")
    nominal, adjusted = design_file.load(base / "fit" / "rig.toml"), design_file.load(out / "rig.toml")
    assert np.abs(difference(nominal.cameras[0].pose, adjusted.cameras[0].pose)).max() > 1e-4
    again = recording.load(out)  # what was measured is itself a recording
    assert again.poses.covariance.shape == (60, 6, 6)
    page = (out / "report.html").read_text()
    links = Links()
    links.feed(page)
    assert not links.outside and page.count("data:image/png") >= 3 and "http" not in page.replace("data:image", "")


def test_the_recording_stays_as_it_was(worked, tmp_path, design, rig_text):
    folder = tmp_path / "rec"
    make_recording(folder, design, rig_text, 1, count=10)
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    run("measure", folder, "--out", tmp_path / "out")
    done = run("measure", folder, "--out", folder, ok=False)
    assert "stays as it was" in done.stderr
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before


def test_calibration_corrects_the_true_machine(worked, tmp_path):
    base, secret = worked
    wanted = hexapod.forward(secret.stated.mechanism.strut_range.mean(axis=1) + 0.02 * np.random.default_rng(0).uniform(-1, 1, (30, 6)),
                             secret.stated.mechanism)
    writing.write_poses(tmp_path / "wanted.csv", recording.Poses(np.arange(30) * 2, wanted, None))
    run("correct", base / "calibration.json", "--poses", tmp_path / "wanted.csv", "--out", tmp_path / "commands.csv")
    lines = (tmp_path / "commands.csv").read_text().splitlines()
    assert lines[0] == "frame,l1,l2,l3,l4,l5,l6" and [int(line.split(",")[0]) for line in lines[1:]] == list(range(0, 60, 2))
    commands = np.array([line.split(",")[1:] for line in lines[1:]], float)
    after = difference(wanted, hexapod.forward(commands, secret.true.mechanism))
    before = difference(wanted, hexapod.forward(hexapod.inverse(wanted, secret.stated.mechanism), secret.true.mechanism))
    assert np.linalg.norm(before[:, :3], axis=1).mean() > 15 * np.linalg.norm(after[:, :3], axis=1).mean()


def test_calibration_says_where_it_comes_from(worked):
    tree = json.loads((worked[0] / "calibration.json").read_text())
    origin = tree["provenance"]
    assert set(origin["inputs_sha256"]) == {"rig.toml", "commands.csv", "frames.csv", "corners.csv", "sensors.csv"}
    assert origin["seed"] == 0 and "numpy" in origin["versions"] and origin["arguments"][0] == "calibrate"
    assert tree["held_out"]["after"]["n"] == 60 and (worked[0] / "calibration.html").exists()


def test_same_input_same_output(worked, tmp_path):
    base, _ = worked
    run("calibrate", base / "fit", "--out", tmp_path / "again.json")
    first, again = (json.loads(path.read_text()) for path in (base / "calibration.json", tmp_path / "again.json"))
    for tree in (first, again):
        del tree["provenance"]
    assert first == again


def test_verify_reports_held_out_figures(worked):
    base, _ = worked
    tree = json.loads(run("verify", base / "calibration.json", base / "check", "--json").stdout)
    assert tree["n"] == 20 and tree["held_out"] is True
    assert tree["before"]["position"]["rms"] > 15 * tree["after"]["position"]["rms"]
    assert tree["after"]["position"]["rms"] <= tree["after"]["position"]["max"] and "p95" in tree["after"]["rotation"]
    text = run("verify", base / "calibration.json", base / "check").stdout
    assert "N = 20" in text and re.search(r"corrected\s+0\.0", text)
    same = run("verify", base / "calibration.json", base / "fit")
    assert "not held out" in same.stderr


def test_calibrating_what_was_measured_gives_the_same(worked, tmp_path):
    base, _ = worked
    run("calibrate", base / "measured", "--out", tmp_path / "c.json")
    one, two = (np.array(json.loads(path.read_text())["fitted"]["base_joints"]) for path in (base / "calibration.json", tmp_path / "c.json"))
    np.testing.assert_allclose(one, two, atol=3e-6)


def test_poses_from_outside_are_calibrated_too(worked, tmp_path):
    base, secret = worked
    folder = tmp_path / "tracker"
    shutil.copytree(base / "measured", folder)
    (folder / "corners.csv").unlink()
    assert "poses.csv" in run("calibrate", folder, "--out", tmp_path / "c.json").stdout


def test_images_go_all_the_way(tmp_path):
    run("calibrate", BENCH / "fit", "--out", tmp_path / "c.json")
    tree = json.loads(run("verify", tmp_path / "c.json", BENCH / "check", "--json").stdout)
    assert tree["n"] == 6 and tree["ratio"]["position"] > 10
    assert any("images" in name for name in json.loads((tmp_path / "c.json").read_text())["provenance"]["inputs_sha256"])


def test_unreachable_poses_are_listed_and_nothing_is_written(worked, tmp_path):
    base, _ = worked
    (tmp_path / "wanted.csv").write_text("frame,x,y,z,rx,ry,rz\n4,0,0,0.45,0,0,0\n5,0,0,0.75,0,0,0\n6,0.4,0,0.45,0,0,0\n")
    arguments = ("correct", base / "calibration.json", "--poses", tmp_path / "wanted.csv", "--out", tmp_path / "commands.csv")
    done = run(*arguments, ok=False)
    assert "2 of 3 wanted poses cannot be reached" in done.stderr and "frame 5: strut 1" in done.stderr and "frame 6:" in done.stderr
    assert not (tmp_path / "commands.csv").exists()
    done = run(*arguments, "--skip-unreachable")
    assert "left out, as asked" in done.stderr
    assert [line.split(",")[0] for line in (tmp_path / "commands.csv").read_text().splitlines()] == ["frame", "4"]


@pytest.mark.parametrize("arguments, says", [
    (("measure", "nowhere", "--out", "x"), "no such folder"),
    (("calibrate", "nowhere", "--out", "x.json"), "no such folder"),
    (("correct", "nowhere.json", "--poses", "p.csv", "--out", "c.csv"), "no such file"),
    (("verify", "nowhere.json", "nowhere"), "no such file"),
])
def test_a_typo_in_a_path_is_said_in_one_line(arguments, says):
    done = run(*arguments, ok=False)
    assert says in done.stderr and done.stderr.count("\n") == 1 and done.returncode == 1


def test_more_that_goes_wrong(worked, tmp_path):
    base, _ = worked
    (tmp_path / "empty").mkdir()
    assert "empty folder" in run("measure", tmp_path / "empty", "--out", tmp_path / "o", ok=False).stderr
    assert not (tmp_path / "o").exists()
    assert "'lens'" in run("measure", base / "fit", "--out", tmp_path / "o", "--hold", "lens", ok=False).stderr
    assert "make it first" in run("calibrate", base / "fit", "--out", tmp_path / "no/c.json", ok=False).stderr
    assert "is a folder" in run("calibrate", base / "fit", "--out", tmp_path, ok=False).stderr
    (tmp_path / "half.json").write_text((base / "calibration.json").read_text()[:5000])
    assert "cut off" in run("verify", tmp_path / "half.json", base / "check", ok=False).stderr
    still = tmp_path / "still"
    shutil.copytree(base / "check", still)
    (still / "commands.csv").unlink()
    assert "no commands.csv" in run("calibrate", still, "--out", tmp_path / "c.json", ok=False).stderr


def test_held_cameras_stay(worked, tmp_path):
    base, _ = worked
    run("measure", base / "measured", "--out", tmp_path / "o", "--hold", "poses,lenses")
    one, two = design_file.load(base / "measured" / "rig.toml"), design_file.load(tmp_path / "o" / "rig.toml")
    assert np.abs(difference(one.cameras[0].pose, two.cameras[0].pose)).max() < 1e-9


def test_bars_on_a_terminal_and_none_in_a_pipe(tmp_path):
    assert "%" not in run("measure", BENCH / "check", "--out", tmp_path / "o").stderr
    try:
        main, other = pty.openpty()
    except OSError:
        pytest.skip("no pseudo-terminals here")
    termios.tcsetwinsize(other, (24, 80))
    process = subprocess.Popen([*RIG, "measure", str(BENCH / "check"), "--out", str(tmp_path / "p")], stderr=other, stdout=subprocess.DEVNULL)
    os.close(other)
    seen = b""
    try:
        while chunk := os.read(main, 65536):
            seen += chunk
    except OSError:
        pass  # the terminal closed: all has been read
    assert process.wait(timeout=60) == 0
    assert b"reading images" in seen and b"%" in seen


def test_a_rig_can_be_designed_simulated_and_measured(tmp_path):
    run("design", "--radius", "0.25", "--cameras", "2", "--size", "800x600", "--out", tmp_path / "rig.toml")
    assert len(design_file.load(tmp_path / "rig.toml").cameras) == 2
    done = run("simulate", tmp_path / "rig.toml", "--plan", "sobol:12", "--effect", "backlash:strut3:gap=4e-5", "--noise", "0.03", "--seed", "5",
               "--out", tmp_path / "rec", "--truth", tmp_path / "truth.json")
    assert "12 frames" in done.stdout and "backlash at strut 3" in done.stdout
    truth = json.loads((tmp_path / "truth.json").read_text())
    assert truth["effects"][0]["parameters"] == {"gap": 4e-5} and len(truth["poses"]) == 12 and truth["noise_px"] == 0.03
    run("measure", tmp_path / "rec", "--out", tmp_path / "out")
    poses = recording.load_poses(tmp_path / "out" / "poses.csv")
    errors = difference(poses.T_base_platform, RigidTransform.from_matrix(np.array(truth["poses"]).reshape(-1, 4, 4)))
    assert np.abs(errors[:, :3]).max() < 1e-3


@pytest.mark.parametrize("extra, says", [
    (("--plan", "sobl"), "no part 'sobl'"), (("--effect", "backlsh:3"), "'backlash' meant"), (("--noise", "-1"), "at least 0 px"),
    (("--images", "--effect", "edge_bias:cameras:bias=0.1"), "not drawn"), (("--images", "--bits", "10"), "8 or 12"),
    (("--machine", "nowhere.json"), "no such file"),
])
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


def test_nets_are_true_to_scale(tmp_path):
    """The sheet is rasterised and its markers read back: the black border's side and the page are as stated."""
    run("design", "--radius", "0.15", "--cubes", "2", "--out", tmp_path / "rig.toml")
    done = run("print", tmp_path / "rig.toml", "--out", tmp_path / "s.pdf")
    design = design_file.load(tmp_path / "rig.toml")
    assert done.stdout.count("target ") == 4 and (tmp_path / "s.pdf").read_bytes().startswith(b"%PDF")
    import cv2
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    from synthetic import sheets

    target = design.targets[0]
    (_, width, height, draw), = sheets._pages(target)
    figure = Figure(figsize=(width / 25.4, height / 25.4), dpi=254)  # 10 px to the millimetre
    FigureCanvasAgg(figure)
    axes = figure.add_axes((0, 0, 1, 1))
    axes.set(xlim=(0, width), ylim=(0, height))
    draw(axes, 0, 0)
    figure.canvas.draw()
    grey = np.asarray(figure.canvas.buffer_rgba())[..., 0]
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
    np.testing.assert_allclose(places["+y"] - places["+x"], [edge, 0], atol=0.3)  # right of +x, seen from outside, lies +y
    np.testing.assert_allclose(places["+z"] - places["-y"], [0, -edge], atol=0.3)


def test_lens_prints_a_camera_that_a_rig_takes(shared, tmp_path):
    photographs = shared / "photos" / "charuco"
    wanted = [photographs / f"{name}.png" for name in ("01", "03", "05", "10", "11")]
    (tmp_path / "grey.png").write_bytes((photographs / "01.png").read_bytes())
    import cv2

    cv2.imwrite(str(tmp_path / "grey.png"), np.full((1200, 1600), 90, np.uint8))
    done = run("lens", *wanted, tmp_path / "grey.png", "--board", "charuco:5x7:0.036195:0.018256:DICT_6X6_250", "--out", tmp_path / "out")
    assert "grey.png: the board is not found in it" in done.stderr and "5 of 6 photographs" in done.stderr
    rig = tmp_path / "rig.toml"
    rig.write_text('schema = "rig/1"\n[mechanism]\nkind = "free"\n' + done.stdout)
    camera = design_file.load(rig).cameras[0]
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
    assert "broken.png: cannot be decoded" in run("lens", tmp_path, "--board", board, ok=False).stderr
    cv2.imwrite(str(tmp_path / "broken.png"), np.zeros((40, 60), np.uint8))
    nothing = run("lens", tmp_path, "--board", board, ok=False).stderr
    assert "0 photographs show" in nothing and "broken.png: the board is not found" in nothing
    cv2.imwrite(str(tmp_path / "other.png"), np.zeros((40, 50), np.uint8))
    assert "one camera has one size" in run("lens", tmp_path, "--board", board, ok=False).stderr


def test_measure_names_markers_that_are_exchanged(tmp_path, design, rig_text):
    from rig.effects.marker_swap import MarkerSwap

    folder = tmp_path / "swapped"
    marker = next(face[1] for target in design.targets if target.body == "platform" for face in target.faces if face[0] == "+z")
    other = next(face[1] for target in design.targets[::-1] if target.body == "platform" for face in target.faces if face[0] == "+z")
    assert marker != other
    _, truth = make_recording(folder, design, rig_text, 5, count=10, effects=(MarkerSwap(f"marker {marker}", other=float(other)),))
    done = run("measure", folder, "--out", tmp_path / "out")
    said = f"marker {marker}: is exchanged with marker {other}"
    assert "2 markers are not what rig.toml says" in done.stdout and said in done.stdout
    assert said in (tmp_path / "out/report.html").read_text()
    assert np.abs(difference(recording.load_poses(tmp_path / "out/poses.csv").T_base_platform, truth)).max() < 1e-3
