"""Cameras of Kalibr, multical, caliscope, ROS and OpenCV see, once imported, what OpenCV's own functions make of the
same files.
"""

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest
import yaml

from rig.errors import RigError
from rig.formats.exporters import json_csv_linuxcnc_and_camera_file_exports as exported
from rig.formats.rig_toml import camera_instrument_experiment_and_cube_turn_entries, design_from_rig_toml
from rig.model.pose import exp
from rig.planning.layout import hexapod_layout_and_camera_placement
from tests.calib.checks.test_mistakes import run_in_process
from vision.opencv_lens_model import project

WIDE = {"pinhole": [620.0, 615.0, 642.5, 480.25], "equidistant": [0.012, -0.004, 0.0015, -0.0003]}


@pytest.fixture
def stated(tmp_path):
    """A rig.toml as its owner believes it, and its cameras."""
    path = tmp_path / "rig.toml"
    path.write_text(
        hexapod_layout_and_camera_placement.hexapod_layout_rig_toml(0.3, cameras=3, width=1280, height=960, cubes=3)
    )
    return path, design_from_rig_toml.load_design(path).cameras


@pytest.fixture
def true(stated):
    """The cameras as they are: elsewhere than stated by centimetres, with lenses of their own, the first where it is
    stated.
    """
    rng = np.random.default_rng(5)
    bent = np.array([-0.2, 0.05, 1e-3, -2e-5])
    return [
        replace(
            camera,
            matrix=camera.matrix + [[7, 0, 0.25], [0, -3, 1.75], [0, 0, 0]],
            distortion=bent * rng.uniform(0.5, 1.5, 4),
            pose=camera.pose * exp(rng.normal(size=6) * (0.02 if i else 0)),
        )
        for i, camera in enumerate(stated[1])
    ]


def seen_by_opencv(T_camera_base, matrix, distortion, points, fisheye=False):
    """Pixels (n, 2) as OpenCV has them; T_camera_base : (4, 4)"""
    rvec, tvec = cv2.Rodrigues(T_camera_base[:3, :3])[0], T_camera_base[:3, 3].copy()
    function = cv2.fisheye.projectPoints if fisheye else cv2.projectPoints
    return function(points[:, None], rvec, tvec, np.asarray(matrix, float), np.asarray(distortion, float))[0].reshape(
        -1, 2
    )


def seen(camera, points):
    return project(camera.pose.inv().apply(points), camera.matrix, camera.distortion)


def points(camera, depth=1.0):
    """(100, 3) m, points of the base frame that a camera has all over its image."""
    uv = np.stack(np.meshgrid(np.linspace(5, 1275, 10), np.linspace(5, 955, 10)), -1).reshape(-1, 2)
    ideal = cv2.undistortPoints(uv, camera.matrix, camera.distortion).reshape(-1, 2)
    return camera.pose.apply(np.column_stack([ideal, np.ones(len(ideal))]) * depth)


def chain(true):
    """What Kalibr writes of cameras: each one's pose by the one before it."""
    tree = {}
    for i, camera in enumerate(true):
        fx, fy, (cx, cy) = camera.matrix[0, 0], camera.matrix[1, 1], camera.matrix[:2, 2]
        tree[f"cam{i}"] = {
            "cam_overlaps": [],
            "camera_model": "pinhole",
            "distortion_model": "radtan",
            "distortion_coeffs": camera.distortion.tolist(),
            "intrinsics": [float(v) for v in (fx, fy, cx, cy)],
            "resolution": [1280, 960],
            "rostopic": f"/cam{i}/image_raw",
        }
        if i:
            tree[f"cam{i}"]["T_cn_cnm1"] = (
                np.linalg.inv(camera.pose.as_matrix()) @ true[i - 1].pose.as_matrix()
            ).tolist()
    return tree


def extrinsics(true, world):
    """(4, 4) each that takes points of a world frame to a camera; world : T_base_world"""
    return [np.linalg.inv(camera.pose.as_matrix()) @ world.as_matrix() for camera in true]


def kalibr(true, folder):
    (folder / "camchain.yaml").write_text(yaml.safe_dump(chain(true)))
    return folder / "camchain.yaml"


def multical(true, folder, master=False):
    names = [camera.name for camera in true]
    T = extrinsics(true, true[0].pose if master else true[1].pose * exp(np.array([0.3, -0.2, 0.5, 0.4, -1.0, 0.2])))
    tree = {
        "cameras": {
            c.name: {
                "model": "standard",
                "image_size": [1280, 960],
                "K": c.matrix.tolist(),
                "dist": [[*c.distortion.tolist(), 0.0]],
            }
            for c in true
        },
        "camera_poses": {
            (f"{name}_to_{names[0]}" if master and name != names[0] else name): {
                "R": M[:3, :3].tolist(),
                "T": M[:3, 3].tolist(),
            }
            for name, M in zip(names, T)
        },
    }
    (folder / "calibration.json").write_text(json.dumps(tree))
    return folder / "calibration.json"


def caliscope(true, folder, matrices=False):
    lines = []
    for i, (c, M) in enumerate(zip(true, extrinsics(true, exp(np.array([1.0, 2, 3, 0.5, 0.2, 2.0]))))):
        turn = M[:3, :3].tolist() if matrices else cv2.Rodrigues(M[:3, :3])[0].ravel().tolist()
        lines += [
            f"[cameras.{i}]",
            f"cam_id = {i}",
            "rotation_count = 0",
            "ignore = false",
            "size = [1280, 960]",
            f"matrix = {c.matrix.tolist()}",
            f"distortions = {[*c.distortion.tolist(), 0.0]}",
            f"translation = {M[:3, 3].tolist()}",
            f"rotation = {turn}",
            "",
        ]
    (folder / "camera_array.toml").write_text(
        "\n".join(
            [
                *lines,
                "[cameras.9]",
                "cam_id = 9",
                "ignore = true",
                "size = [1280, 960]",
                "matrix = []",
                "distortions = []",
            ]
        )
    )
    return folder / "camera_array.toml"


RESULTS = {
    "Kalibr": (kalibr, ()),
    "multical": (multical, ()),
    "multical, master": (lambda *a: multical(*a, master=True), ()),
    "caliscope": (caliscope, ("cam_{}",)),
    "caliscope, matrices": (lambda *a: caliscope(*a, matrices=True), ("cam_{}",)),
}


@pytest.mark.parametrize("name", RESULTS)
def test_a_result_of_another_program_sees_what_opencv_sees(name, stated, true, tmp_path):
    made, theirs = RESULTS[name]
    names = (
        [
            word
            for i, camera in enumerate(true)
            for word in ("--set", f"cameras.names.{theirs[0].format(i)}={camera.name}")
        ]
        if theirs
        else []
    )
    status, text = run_in_process(
        "import", "--rig", stated[0], "--cameras", made(true, tmp_path), *names, "--out", tmp_path / "out.toml"
    )
    assert status == 0 and f"is a result of {name.partition(',')[0]}: 3 cameras" in text, text
    for camera, meant in zip(design_from_rig_toml.load_design(tmp_path / "out.toml").cameras, true):
        at = points(meant)
        assert (
            np.abs(
                seen(camera, at)
                - seen_by_opencv(np.linalg.inv(meant.pose.as_matrix()), meant.matrix, meant.distortion, at)
            ).max()
            < 2e-5
        )
        assert camera.name == meant.name


def test_cameras_that_rig_toml_lacks_are_added_where_their_place_is_told(true, tmp_path):
    bare = tmp_path / "bare.toml"
    bare.write_text('schema = "rig/1"\n[mechanism]\nkind = "free"\n')
    file = kalibr(true, tmp_path)
    status, text = run_in_process("import", "--rig", bare, "--cameras", file, "--out", tmp_path / "out.toml")
    assert status == 1 and "cameras.at=X Y Z RX RY RZ" in text
    first = true[0].pose
    at = " ".join(map(repr, (*first.translation.tolist(), *first.rotation.as_rotvec().tolist())))
    status, text = run_in_process(
        "import", "--rig", bare, "--cameras", file, "--set", f"cameras.at={at}", "--out", tmp_path / "out.toml"
    )
    assert (
        status == 0
        and "added to rig.toml: cam0, cam1, cam2" in text
        and "enter its pose" not in (tmp_path / "out.toml").read_text()
    )
    for camera, meant in zip(design_from_rig_toml.load_design(tmp_path / "out.toml").cameras, true):
        assert np.abs(seen(camera, points(meant)) - seen(meant, points(meant))).max() < 2e-5


def test_an_equidistant_lens_becomes_a_rational_one_that_opencvs_fisheye_agrees_with(stated, true, tmp_path):
    tree = chain(true)
    tree["cam1"] |= {
        "distortion_model": "equidistant",
        "distortion_coeffs": WIDE["equidistant"],
        "intrinsics": WIDE["pinhole"],
    }
    (tmp_path / "camchain.yaml").write_text(yaml.safe_dump(tree))
    status, text = run_in_process(
        "import", "--rig", stated[0], "--cameras", tmp_path / "camchain.yaml", "--out", tmp_path / "out.toml"
    )
    assert status == 0 and "cam1: its equidistant lens becomes OpenCV's rational one" in text, text
    camera = design_from_rig_toml.load_design(tmp_path / "out.toml").cameras[1]
    fx, fy, cx, cy = WIDE["pinhole"]
    K = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    ideal = cv2.fisheye.undistortPoints(
        np.stack(np.meshgrid(np.linspace(0, 1279, 30), np.linspace(0, 959, 30)), -1).reshape(-1, 1, 2),
        K,
        np.array(WIDE["equidistant"]),
    ).reshape(-1, 2)
    at = camera.pose.apply(np.column_stack([ideal, np.ones(len(ideal))]))
    off = seen(camera, at) - seen_by_opencv(
        np.linalg.inv(camera.pose.as_matrix()), K, WIDE["equidistant"], at, fisheye=True
    )
    assert np.degrees(np.arctan(np.abs(ideal).max())) > 45 and 1e-7 < np.abs(off).max() < 0.02


@pytest.mark.parametrize("suffix", ["yml", "json"])
def test_what_opencv_writes_is_read_and_what_it_reads_is_written(suffix, stated, true, tmp_path):
    meant = replace(true[2], distortion=np.array([0.3, -0.1, 1e-5, 2e-4, 0.02, 0.1, -0.03, 1e-6]))
    file = cv2.FileStorage(str(tmp_path / f"lens.{suffix}"), cv2.FILE_STORAGE_WRITE)
    for key, value in (
        ("image_width", 1280),
        ("image_height", 960),
        ("camera_matrix", meant.matrix),
        ("distortion_coefficients", meant.distortion),
    ):
        file.write(key, value)
    file.release()
    words = ("import", "--rig", stated[0], "--cameras", tmp_path / f"lens.{suffix}", "--out", tmp_path / "out.toml")
    assert run_in_process(*words)[0] == 1  # of which camera?
    assert run_in_process(*words, "--set", f"cameras.names.lens={meant.name}")[0] == 0
    found = design_from_rig_toml.load_design(tmp_path / "out.toml").camera(meant.name)
    np.testing.assert_allclose(found.matrix, meant.matrix, atol=1e-6)
    np.testing.assert_allclose(found.distortion, meant.distortion, atol=1e-9)
    assert run_in_process("export", tmp_path / "out.toml", "--format", "opencv", "--out", tmp_path / "cv")[0] == 0
    read = cv2.FileStorage(str(tmp_path / "cv" / f"{meant.name}.yaml"), cv2.FILE_STORAGE_READ)
    assert (
        np.array_equal(read.getNode("camera_matrix").mat(), found.matrix) and read.getNode("image_height").real() == 960
    )
    assert np.array_equal(read.getNode("distortion_coefficients").mat().ravel(), found.distortion)


def test_camera_info_goes_both_ways(stated, true, tmp_path):
    out = tmp_path / "changed.toml"
    out.write_text(
        camera_instrument_experiment_and_cube_turn_entries.rig_toml_with_camera_values_replaced(
            stated[0].read_text(), true
        )
    )
    assert run_in_process("export", out, "--format", "camera-info", "--out", tmp_path / "info")[0] == 0
    tree = yaml.safe_load((tmp_path / "info" / f"{true[1].name}.yaml").read_text())
    assert (
        tree["distortion_model"] == "plumb_bob"
        and tree["projection_matrix"]["data"][:3] == tree["camera_matrix"]["data"][:3]
    )
    assert all(isinstance(value, float) for value in tree["distortion_coefficients"]["data"])
    files = [tmp_path / "info" / f"{camera.name}.yaml" for camera in true]
    assert run_in_process("import", "--rig", stated[0], "--cameras", *files, "--out", tmp_path / "back.toml")[0] == 0
    for camera, original, meant in zip(
        design_from_rig_toml.load_design(tmp_path / "back.toml").cameras, stated[1], true
    ):
        assert (
            np.abs(camera.matrix - meant.matrix).max() < 1e-6
            and np.abs(camera.distortion[:4] - meant.distortion).max() < 1e-9
        )
        assert np.abs((camera.pose.inv() * original.pose).translation).max() < 1e-9  # a camera_info has no place
    with pytest.raises(RigError, match="12 terms; camera_info"):
        exported.ros_camera_info(replace(true[0], distortion=np.zeros(12)))


def spoilt(true, **changes):
    """A camchain with changes to cam1."""
    tree = chain(true)
    tree["cam1"] |= changes
    return yaml.safe_dump(tree)


WRONG = {
    "omni": (
        dict(camera_model="omni", intrinsics=[1.0, 600.0, 600.0, 640.0, 480.0]),
        "cam1.camera_model = 'omni': the omnidirectional model",
    ),
    "fov": (dict(distortion_model="fov", distortion_coeffs=[0.9]), "cam1.distortion_model = 'fov' is not supported"),
    "too wide": (
        dict(distortion_model="equidistant", distortion_coeffs=[0.1, 0, 0, 0], intrinsics=[300.0, 300.0, 640.0, 480.0]),
        "cam1.distortion_model: an equidistant lens",
    ),
    "mirrored": (dict(T_cn_cnm1=np.diag([1.0, 1, -1, 1]).tolist()), "cam1.T_cn_cnm1 is not a rotation"),
    "size": (dict(resolution=[640, 480]), "was calibrated at 640x480 px, and rig.toml has 1280x960"),
    "focal": (
        dict(intrinsics=[-600.0, 600.0, 640.0, 480.0]),
        "cam1.intrinsics[1]: the focal length must be positive px, not -600",
    ),
    "words": (dict(distortion_coeffs=["a", 0, 0, 0]), "cam1.distortion_coeffs[1] must be a number, not 'a'"),
    "nan": (dict(distortion_coeffs=[float("nan"), 0, 0, 0]), "is not finite"),
}


@pytest.mark.parametrize("name", WRONG)
def test_what_has_no_place_here_is_refused_by_name_with_file_and_line(name, stated, true, tmp_path):
    changes, says = WRONG[name]
    file = tmp_path / "camchain.yaml"
    file.write_text(spoilt(true, **changes))
    status, text = run_in_process("import", "--rig", stated[0], "--cameras", file, "--out", tmp_path / "out.toml")
    line = int(text.partition("camchain.yaml:")[2].partition(":")[0])
    assert status == 1 and says in text and line >= 20 and not (tmp_path / "out.toml").exists(), text


def test_half_files_and_other_files_are_refused(stated, true, tmp_path):
    good = yaml.safe_dump(chain(true))
    many = "a: &a [1,1,1,1,1,1,1,1,1,1]\n" + "".join(
        f"{y}: &{y} [{','.join([f'*{x}'] * 10)}]\n" for x, y in zip("abcdefg", "bcdefgh")
    )
    texts = {
        "half.yaml": (good[: good.index("intrinsics", 900) + 30], "cam2.intrinsics must have 4 numbers, got 2"),
        "target.yaml": ("target_type: 'aprilgrid'\ntagCols: 6\n", "a target of Kalibr"),
        "text.yaml": ("some words\n", "holds no table"),
        "twice.yaml": ("a: 1\na: 2\n", "a occurs twice"),
        "other.yaml": ("a: 1\n", "its keys are a"),
        "laughs.yaml": (many, "more than 100000 values"),
        "ring.yaml": ("a: &a [*a]\n", "nested too deep"),
        "gap.yaml": (good.replace("cam1", "cam7"), "missing"),
        "none.json": ("{", "not valid JSON"),
        "x.xml": ("<a/>", "XML of OpenCV"),
    }
    for name, (text, says) in texts.items():
        (tmp_path / name).write_text(text)
        status, message = run_in_process(
            "import", "--rig", stated[0], "--cameras", tmp_path / name, "--out", tmp_path / "out.toml"
        )
        assert status == 1 and says in message and name in message and "Traceback" not in message, message
    status, message = run_in_process(
        "import", "--rig", stated[0], "--cameras", tmp_path / "nowhere.yaml", "--out", tmp_path / "out.toml"
    )
    assert status == 1 and "nowhere.yaml: no such file" in message


def test_a_recording_keeps_the_cameras_and_its_recipe_brings_them_again(stated, true, tmp_path):
    for camera in true:
        (tmp_path / "images" / camera.name).mkdir(parents=True)
        for frame in range(2):
            cv2.imwrite(str(tmp_path / "images" / camera.name / f"{frame}.png"), np.zeros((960, 1280), np.uint8))
    (tmp_path / "times.csv").write_text("frame,t [s]\n0,0\n1,1\n")
    rec = tmp_path / "rec"
    status, text = run_in_process(
        "import",
        tmp_path / "images",
        "--rig",
        stated[0],
        "--frames",
        tmp_path / "times.csv",
        "--cameras",
        kalibr(true, tmp_path),
        "--out",
        rec,
    )
    assert status == 0, text
    assert run_in_process("import", "--recipe", tmp_path / "rec.import.toml", "--out", tmp_path / "again")[0] == 0
    assert (rec / "rig.toml").read_text() == (tmp_path / "again" / "rig.toml").read_text() != stated[0].read_text()
