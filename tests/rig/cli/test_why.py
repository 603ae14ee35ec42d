"""rig why: one table and a model of the machine in, five lines out; what cannot be read is refused by name."""

import json
import shutil
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

import calib
from calib.api.options_and_imported_data_of_why import recording_and_whether_noise_is_assumed
from calib.api.why import _repeats
from rig.errors import RigError
from rig.formats.exporters.urdf_and_sdf_export_of_arms_and_hexapods import arm_urdf
from rig.formats.importers.arm_from_urdf_dh_or_screw_axis_table import ArmFileOptions
from rig.model.design import Arm
from rig.model.pose import pose_to_vector
from rig.recording.recording_folder import load_recording
from tests.calib import secret_arms
from tests.cli import run
from tests.rig.formats.importers.test_bags import START, ros2

HALF = np.pi / 2
NOMINAL = Arm(
    [[0, 0.3, 0, HALF], [0, 0, 0.4, 0], [0, 0, 0.3, HALF]], [[-3, 3], [-2, 2], [-2.5, 2.5]]
)  # three joints: few parameters, so that few poses do
NAMES = ("shoulder", "elbow", "wrist")
SIGMA = (2e-5, 1e-4)  # m, rad
WAVE = 1.5e-3  # rad


def wave(q):
    """(n, 3) rad by which the second joint errs, three times a turn."""
    return np.stack([0 * q[:, 0], WAVE * np.sin(3 * q[:, 1] + 0.4), 0 * q[:, 0]], axis=1)


def table(path, header, columns):
    rows = [",".join(repr(float(x)) for x in row) for row in np.column_stack(columns)]
    path.write_text("\n".join([header, *rows]) + "\n")
    return path


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    """A folder with the URDF of an arm, and joint values and poses of another one as one table."""
    folder = tmp_path_factory.mktemp("why")
    rng = np.random.default_rng(4)
    true = secret_arms.secret(NOMINAL, rng)
    samples = secret_arms.tracked(true, NOMINAL, 60, rng, SIGMA, deviation=wave, repeats=8)
    text = arm_urdf(NOMINAL, "three")
    for axis, name in zip(NOMINAL.axes, NAMES):
        text = text.replace(f'name="{axis}"', f'name="{name}"')
    (folder / "arm.urdf").write_text(text)
    poses = pose_to_vector(samples.T_base_platform)
    table(folder / "data.csv", f"time_s,{','.join(NAMES)},x,y,z,rx,ry,rz", (samples.t, samples.commanded, poses))
    return folder


@pytest.fixture(scope="module")
def why_result(arm):
    """What the command prints about it, and the folder that it keeps."""
    done = run("why", arm / "data.csv", "--urdf", arm / "arm.urdf", "--out", arm / "kept")
    return done, arm / "kept"


def test_five_lines_are_right(why_result):
    done, folder = why_result
    lines = done.stdout.splitlines()
    assert [line.partition(": ")[0] for line in lines] == ["how wrong", "why", "how sure", "what to do", "measure next"]
    assert "read joint elbow: revolute, limits -114.592 .. 114.592 deg" in done.stderr
    held = calib.load(folder / "calibration.json").held_out
    assert (
        f"off by {held.before.mean[0] * 1e3:.3g} mm on average, 95 % within {held.before.position[1] * 1e3:.3g}"
        in (lines[0])
    )
    assert 3e-4 < held.before.mean[0] < 3e-3  # as large as the errors that were drawn
    assert "the geometry differs from the stated one" in lines[1] and "joint 2" in lines[1]
    noise = np.sqrt(3) * SIGMA[0]
    assert held.after.position[0] < 2 * noise and f"after calibration {held.after.mean[0] * 1e3:.3g} mm" in lines[2]
    assert "over 8 repeated configurations" in lines[2]
    assert f"measurement noise {noise * 1e3:.3g} mm, assumed" in lines[2]
    assert "rig correct calibration.json" in lines[3]


def test_out_keeps_what_the_lines_rest_on(why_result):
    _, folder = why_result
    found = sorted(path.name for path in folder.iterdir())
    assert {"calibration.json", "diagnosis", "diagnosis.html", "recording"} <= set(found)
    assert json.loads((folder / "diagnosis" / "diagnosis.json").read_text())["schema"] == "diagnosis/1"
    assert run("check", folder / "recording").returncode == 0


@pytest.mark.parametrize("measured, stated", [("pose", "1 mm and 0.057 degrees"), ("position", "1 mm")])
def test_repeatability_is_stated_of_what_was_measured(measured, stated):
    displacement = np.repeat([[1e-3], [-1e-3]], 2, axis=0)  # m, rad
    T = RigidTransform.from_components(displacement * [1, 0, 0], Rotation.from_rotvec(displacement * [0, 0, 1]))
    samples = SimpleNamespace(commanded=np.zeros((4, 3)), T_base_platform=T, measured=measured)
    repeats = _repeats(SimpleNamespace(sampled=SimpleNamespace(samples=samples)))
    size = np.sqrt(4 / 3)  # of four values at +-1 about a mean that they are of
    assert repeats.position == pytest.approx(1e-3 * size) and (repeats.rotation is None) == (measured == "position")
    assert str(replace(repeats, position=1e-3, rotation=repeats.rotation and 1e-3)) == (
        f"repeatability {stated} RMS over 1 repeated configurations"
    )


@pytest.mark.slow
def test_positions_alone_in_another_folder_and_units_by_python(arm, tmp_path):
    """Two tables without times, in degrees and millimetres, a table of rows in place of the URDF."""
    rows = [line.split(",") for line in (arm / "data.csv").read_text().split()[1:]]
    values = np.array(rows, float)
    table(tmp_path / "commands.csv", ",".join(f"{name} [deg]" for name in NAMES), (np.degrees(values[:, 1:4]),))
    table(tmp_path / "poses.csv", "x_mm,y_mm,z_mm", (1e3 * values[:, 4:7],))
    dh = tmp_path / "rows" / "dh.csv"
    dh.parent.mkdir()
    dh.write_text("name,alpha_deg,a_mm,d_mm,theta_deg\nshoulder,90,0,300,0\nelbow,0,400,0,0\nwrist,90,300,0,0\n")
    lines = []
    options = calib.WhyOptions(ArmFileOptions(dh=dh), position_sigma=SIGMA[0])
    result = calib.why(tmp_path, options, notice=lines.append)
    assert "poses.csv has positions alone, no rotations" in lines
    answers = result.answers()
    assert "degrees" not in answers["how wrong"] and "assumed" not in answers["how sure"]
    assert result.calibrated.calibration.held_out.after.position[0] < 3 * np.sqrt(3) * SIGMA[0]
    tree = json.loads(json.dumps(result.tree(), default=str))
    assert tree["schema"] == "why/1" and list(tree["answers"]) == list(answers) and not tree["noise_is_assumed"]
    assert str(result).startswith("how wrong") and result._repr_html_().startswith("<div>")


@pytest.mark.slow
def test_a_bag_of_joint_states_and_poses_gives_the_answers_of_the_table(arm, why_result, tmp_path):
    """As a driver publishes it: the URDF's joint names in another order, each configuration twice around its pose."""
    values = np.array([line.split(",") for line in (arm / "data.csv").read_text().split()[1:]], float)
    found = []
    for t, q, pose in zip(values[:, 0], values[:, 1:4], values[:, 4:]):
        for after in (0.0, 4.0):
            found.append(stamped(t + after, "/joint_states", "sensor_msgs/msg/JointState", joint_state_fields(q)))
        found.append(stamped(t + 2, "/tracker", "geometry_msgs/msg/TransformStamped", transform_fields(pose)))
    bag = ros2(tmp_path / "run", found)
    done = run("why", bag, "--urdf", arm / "arm.urdf", "--out", tmp_path / "kept")
    assert "/joint_states is commands" in done.stderr and "/tracker is poses" in done.stderr
    of_table = why_result[0].stdout.splitlines()
    assert [line[:60] for line in done.stdout.splitlines()] == [line[:60] for line in of_table]


@pytest.mark.slow
def test_a_folder_of_images_with_its_rig_and_commands(tmp_path, opengl):
    """The images' times are the commands' rows', or those of a table."""
    rig, data = tmp_path / "rig.toml", tmp_path / "data"
    run("new", "design", "--radius", 0.3, "--size", "640x480", "--cubes", 3, "--out", rig)
    run("simulate", rig, "--plan", "sobol:16", "--seed", 4, "--images", "--out", tmp_path / "rec")
    recorded = load_recording(tmp_path / "rec")
    data.mkdir()
    shutil.copy(rig, data)
    for camera in (tmp_path / "rec" / "images").iterdir():
        shutil.copytree(camera, data / camera.name)
    shutil.copy(tmp_path / "rec" / "commands.csv", data)
    frames, t = recorded.exposures.times()
    problem = run("why", data, ok=False).stderr
    assert f"there are 16 frames and {len(recorded.commands.t)} rows" in problem and "frames.csv beside" in problem
    table(data / "frames.csv", "frame,t", (frames, t))
    found, assumed = recording_and_whether_noise_is_assumed(data, calib.WhyOptions(), tmp_path, [].append)
    np.testing.assert_allclose(found.exposures.times()[1], t - t[0] + found.exposures.times()[1][0], atol=1e-9)
    assert found.has_images and len(found.commands.t) == len(recorded.commands.t) and not assumed
    (data / "frames.csv").unlink()
    table(data / "commands.csv", "t,l1,l2,l3,l4,l5,l6", (t, recorded.commands.at(t)))
    done = run("why", data)
    assert "the 16 frames belong to the 16 rows of commands.csv" in done.stderr
    lines = done.stdout.splitlines()
    assert "mm on average" in lines[0] and "on 16 poses that were held out" in lines[0]
    assert "the geometry differs from the stated one (100.0% of the mean square error" in lines[1]
    assert "times better" in lines[2] and "use corrected commands" in lines[3]


@pytest.mark.slow
def test_the_real_arm_is_off_by_its_geometry_and_by_its_gears(shared):
    done = run("why", shared / "recordings" / "arm-1")
    wrong, why, sure, to_do, measure = done.stdout.splitlines()
    assert "off by 1.03 mm on average" in wrong and "on 1493 poses that were held out" in wrong
    assert "the geometry differs from the stated one (83" in why and "transmission error at joints 1, 2" in why
    assert "nothing we know explains the rest" in why
    before, after = (float(text.split("calibration ")[-1].split(" mm")[0].split()[-1]) for text in (wrong, sure))
    assert after < 0.1 * before and "no configuration was visited twice" in sure
    assert "transmission error at joint 1" in to_do and "rig correct" in to_do
    assert "direction of approach is 93 % to 96 % a function of place" in measure


def stamped(t, topic, kind, fields):
    """(topic, type, ns, fields) of a message at t (s)."""
    ns = START + round(t * 1e9)
    stamp = {"sec": ns // 10**9, "nanosec": ns % 10**9}
    return topic, kind, ns, {"header": {"seq": 0, "stamp": stamp, "frame_id": "base"}, **fields}


def joint_state_fields(q):
    """Fields of a JointState of joint values (3,) rad, the last joint first."""
    return {"name": list(NAMES[::-1]), "position": q[::-1].tolist(), "velocity": [], "effort": []}


def transform_fields(vector):
    """Fields of a TransformStamped of a pose (6,) m, rad."""
    place, quaternion = vector[:3].tolist(), Rotation.from_rotvec(vector[3:]).as_quat().tolist()
    transform = {"translation": dict(zip("xyz", place)), "rotation": dict(zip("xyzw", quaternion))}
    return {"child_frame_id": "flange", "transform": transform}


def test_refusals(arm, tmp_path):
    urdf = ("--urdf", arm / "arm.urdf")

    def refused(*words):
        return run("why", *words, ok=False).stderr

    assert f"is '{arm / 'data.csv'}' meant?" in refused(arm / "dta.csv", *urdf)
    empty = tmp_path / "empty"
    empty.mkdir()
    assert "is an empty folder; it takes a recording" in refused(empty, *urdf)
    whole = (arm / "data.csv").read_text()
    half = tmp_path / "half.csv"
    half.write_text(whole[: len(whole) // 2 - 7])
    assert "half.csv:" in refused(half, *urdf) and "cut off" in refused(half, *urdf)
    assert "add --urdf FILE.urdf, --dh FILE.csv" in refused(arm / "data.csv")
    assert "is no link; is 'platform' meant?" in refused(arm / "data.csv", *urdf, "--tip", "platfrom")
    assert "give only one" in refused(arm / "data.csv", *urdf, "--rig", "rig.toml")
    odd = tmp_path / "data.xlsx"
    odd.write_text("x")
    assert "is of no kind that is known" in refused(odd, *urdf)
    several = tmp_path / "several"
    several.mkdir()
    (several / "a.csv").write_text(whole)
    (several / "b.csv").write_text(whole)
    assert "holds several tables (a.csv, b.csv)" in refused(several, *urdf)
    assert not any(path.name == "kept" for path in tmp_path.iterdir())


def test_a_recording_that_lacks_its_machine_is_read_with_the_one_that_is_stated(why_result, tmp_path):
    _, folder = why_result
    bare, lines = tmp_path / "bare", []
    bare.mkdir()
    for name in ("commands.csv", "poses.csv", "frames.csv"):
        (bare / name).write_text((folder / "recording" / name).read_text())
    with pytest.raises(RigError, match="does not state the machine"):
        recording_and_whether_noise_is_assumed(bare, calib.WhyOptions(), tmp_path, lines.append)
    options = calib.WhyOptions(rig=folder / "recording" / "rig.toml")
    found, assumed = recording_and_whether_noise_is_assumed(bare, options, tmp_path, lines.append)
    np.testing.assert_array_equal(found.design.mechanism.joints[:, 1], NOMINAL.joints[:, 1])
    assert len(found.poses.frame) == 60 and not assumed and not lines
    (tmp_path / "again").mkdir()
    recording_and_whether_noise_is_assumed(folder / "recording", options, tmp_path / "again", lines.append)
    assert lines == [f"{folder / 'recording' / 'rig.toml'} is not read: the machine is stated otherwise"]


def test_a_body_that_nobody_commands_is_refused_by_what_it_is(shared):
    output = run("why", shared / "recordings" / "tumbling-block", ok=False).stderr
    assert 'is a recording of kind "free": 1 camera watched a body in 542 frames that nothing commanded' in output
    assert "rig measure" in output


def test_options():
    with pytest.raises(RigError, match="--position-sigma belongs to --urdf"):
        calib.WhyOptions(position_sigma=1e-5)
    with pytest.raises(RigError, match="above 0"):
        replace(calib.WhyOptions(), rotation_sigma=0.0)


GANTRY = """<robot name="gantry"><link name="base"/><link name="a"/><link name="b"/><link name="tip"/>
<joint name="X" type="prismatic"><parent link="base"/><child link="a"/><axis xyz="1 0 0"/>
<limit lower="0" upper="0.8" effort="1" velocity="1"/></joint>
<joint name="Y" type="prismatic"><parent link="a"/><child link="b"/><axis xyz="0 1 0"/>
<limit lower="0" upper="0.4" effort="1" velocity="1"/></joint>
<joint name="Z" type="prismatic"><parent link="b"/><child link="tip"/><axis xyz="0 0 1"/>
<limit lower="0" upper="0.5" effort="1" velocity="1"/></joint></robot>
"""


@pytest.mark.parametrize(
    "header",
    ["X [mm],Y [mm],Z [mm],x [mm],y [mm],z [mm]", "X axis,Y axis,Z axis,x,y,z", "q1,q2,q3,x,y,z", "X,Y,Z,px,py,pz"],
)
def test_slides_named_as_the_measured_coordinates_are_not_exchanged_with_them(tmp_path, header):
    rng = np.random.default_rng(2)
    slides = rng.uniform(0, [800, 400, 500], (20, 3))
    measured = slides @ Rotation.from_rotvec([0.1, 0.2, 2.0]).as_matrix().T + [637, 219, 130]
    table(tmp_path / "data.csv", header, (slides, measured))
    (tmp_path / "gantry.urdf").write_text(GANTRY)
    options = calib.WhyOptions(ArmFileOptions(tmp_path / "gantry.urdf"), settings=("poses.unit=mm",))
    recording, _ = recording_and_whether_noise_is_assumed(tmp_path / "data.csv", options, tmp_path, lambda line: None)
    assert np.abs(recording.commands.at(recording.exposures.times()[1]) - slides / 1e3).max() < 1e-9
    assert np.abs(recording.poses.T_base_platform.translation - measured / 1e3).max() < 1e-9


def test_noise_that_residuals_exceed_is_no_floor(arm, tmp_path):
    """The same poses, whose noise is stated a third of what it is."""
    sigma = "--position-sigma", f"{SIGMA[0] / 3 * 1e6:g}um", "--rotation-sigma", f"{SIGMA[1] / 3 * 1e3:g}mrad"
    done = run("why", arm / "data.csv", "--urdf", arm / "arm.urdf", *sigma, "--out", tmp_path / "out")
    lines = done.stdout.splitlines()
    assert "floor:" not in lines[2] and "which the residuals exceed: " in lines[2], lines[2]
    assert "times in position" in lines[2]
    assert "nothing beyond the noise" not in lines[1]
