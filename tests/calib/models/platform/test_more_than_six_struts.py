"""A platform on seven or eight struts against an independent truth of elastic struts: where it rests, how well it is
calibrated, and how much its struts still press against each other.
"""

import json

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from calib.correction.machine_correction import Correction, identify_geometry
from calib.models.platform.platform_identification import identify_platform
from calib.samples.commanded_and_measured_pose_samples import Samples
from rig.checks.unit_and_convention_mistakes import command_unit_mistakes
from rig.errors import RigError
from rig.formats.rig_toml.design_from_rig_toml import load_design
from rig.model.mechanism_geometry_classes import Chain, Hexapod
from rig.model.mechanisms import hexapod, redundant_strut_best_six_legs_and_loop_closures
from rig.model.mechanisms.mechanism_kinds_and_kinematics import require_hexapod
from rig.model.pose import pose_to_vector
from rig.planning.configuration_generators import evenly_spread_configurations
from rig.planning.recording_plan import build_plan
from rig.recording.recording_folder import Commands
from tests.calib import sprung_platforms
from tests.cli import run

POSE = np.repeat([10e-6, 50e-6], 3)  # m, rad
STRUT = 5e-6  # m
NEVER_USED = 60  # poses


def poses(rows):
    return RigidTransform.from_components(rows[:, :3], Rotation.from_rotvec(rows[:, 3:]))


def mechanism(platform, followers=True):
    """The Hexapod of a SprungPlatform."""
    count, middle = len(platform.zeros), np.array([[0, 0, sprung_platforms.HEIGHT, 0, 0, 0]])
    length = platform.lengths(middle)[0]
    some = tuple(one - 1 for one in sprung_platforms.FOLLOWERS[count]) if followers else ()
    ranges = np.stack([length - 0.06, length + 0.06], axis=1)
    return Hexapod(platform.base, platform.plate, ranges, poses(middle)[0], platform.zeros, some)


def samples(seen):
    n = len(seen.rows)
    frames = np.arange(n)
    covariance = np.tile(np.diag(POSE**2), (n, 1, 1))
    return Samples(frames, 10.0 * frames, seen.lengths, poses(seen.seen), covariance, np.zeros((n, 6, 0)))


def bears(platform, lengths):
    """(RMS m that struts give way by, poses (n, 6)) of a platform all of whose struts are driven to lengths."""
    rows = platform.rests(lengths)
    return float(np.sqrt(np.mean((platform.lengths(rows) - lengths) ** 2))), rows


@pytest.mark.parametrize("struts", [7, 8])
def test_a_platform_rests_where_its_elastic_struts_balance(struts):
    rng = np.random.default_rng(struts)
    true = sprung_platforms.drawn(struts, rng)
    lengths = sprung_platforms.stated(struts).lengths(sprung_platforms.somewhere(20, rng))
    lengths += 1e-3 * rng.normal(size=lengths.shape)
    m = mechanism(true, followers=False)
    T = hexapod.forward(lengths, m)
    size, rows = bears(true, lengths)
    np.testing.assert_allclose(pose_to_vector(T), rows, atol=2e-9)  # m, rad
    force = lengths - true.lengths(rows)  # N of a stiffness of 1 N/m
    ends = T.rotation.as_matrix() @ true.plate.T
    ends = np.swapaxes(ends, 1, 2)
    along = ends + T.translation[:, None] - true.base
    along /= np.linalg.norm(along, axis=2, keepdims=True)
    pushes = force[..., None] * along
    assert np.abs(pushes.sum(axis=1)).max() < 1e-9 and np.abs(np.cross(ends, pushes).sum(axis=1)).max() < 1e-9
    np.testing.assert_allclose(
        redundant_strut_best_six_legs_and_loop_closures.incompatible_strut_length_component(T, lengths, m),
        force,
        atol=1e-9,
    )
    assert size > 1e-4
    seen = poses(sprung_platforms.in_own_axes(rows, 10 * POSE * rng.normal(size=rows.shape)))
    np.testing.assert_allclose(
        redundant_strut_best_six_legs_and_loop_closures.incompatible_strut_length_component(seen, lengths, m),
        force,
        atol=4e-6,
    )  # which poses do not move
    even = evenly_spread_configurations(m, 64)
    assert bears(true, even[:8])[0] < 1e-9 and not hexapod.signed_limit_excess(even, m).any()


def test_followers_bear_no_load_and_driven_struts_share_it_as_springs_do():
    rng = np.random.default_rng(3)
    true = sprung_platforms.drawn(8, rng)
    rows, wrench = sprung_platforms.somewhere(5, rng), rng.normal(size=(5, 6)) * [10, 10, 10, 1, 1, 1]
    lengths, stiffness, rates = true.lengths(rows), 1e6, true.by_pose(rows)
    released = hexapod.axis_forces_and_torques(poses(rows), lengths, mechanism(true), wrench)
    assert not released[:, [2, 7]].any()
    loads = hexapod.axis_forces_and_torques(poses(rows), lengths, mechanism(true, followers=False), wrench)
    for force in (released, loads):
        np.testing.assert_allclose(np.einsum("nij,ni->nj", rates, force), -wrench, atol=1e-6)
    moved = np.linalg.solve(
        np.swapaxes(rates, 1, 2) @ rates * stiffness, wrench[..., None]
    )  # by the springs' stiffness
    np.testing.assert_allclose(loads, -stiffness * (rates @ moved)[..., 0], atol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("struts", [7, 8])
def test_all_struts_are_identified_and_no_longer_fight(struts):
    rng = np.random.default_rng(10 + struts)
    true, owner = sprung_platforms.drawn(struts, rng), sprung_platforms.stated(struts)
    seen = sprung_platforms.measured(true, 150, POSE, STRUT, rng)
    found = identify_geometry(samples(seen), mechanism(owner))
    np.testing.assert_allclose(found.scatter, STRUT, rtol=0.15)
    off = np.concatenate(
        [
            (a - b).ravel()
            for a, b in zip(
                (found.mechanism.base_joints, found.mechanism.platform_joints, found.mechanism.strut_zeros),
                (true.base, true.plate, true.zeros),
            )
        ]
    )
    bound = true.bound(seen.rows, POSE, STRUT)
    square = off @ np.linalg.solve(bound, off)
    assert square < 1.7 * len(off)  # chi-square of the bound: as good as it can be known
    wanted = sprung_platforms.somewhere(NEVER_USED, rng)
    np.testing.assert_allclose(true.pose_bound(wanted, found.covariance), true.pose_bound(wanted, bound), rtol=0.1)
    correction = Correction(mechanism(owner), found.mechanism, (None,) * struts)
    scatter = STRUT * rng.normal(size=(NEVER_USED, struts))
    before, after, least = (
        bears(true, lengths + scatter)[0]
        for lengths in (owner.lengths(wanted), correction.inverse(poses(wanted)), true.lengths(wanted))
    )
    assert before > 15 * least and after < 1.1 * least


def recording(folder, text, seen):
    """Write a recording of what was measured, each pose held for two seconds."""
    folder.mkdir()
    (folder / "rig.toml").write_text(text)
    axes = ",".join(f"l{i + 1}" for i in range(seen.lengths.shape[1]))
    rows = [",".join(f"{value:.9f}" for value in row) for row in seen.lengths]
    held = [f"{10 * k + side},{row}" for k, row in enumerate(rows) for side in (0, 2)]
    (folder / "commands.csv").write_text("\n".join([f"t,{axes}", *held]) + "\n")
    frames = [f"{k},{10 * k + 1},," for k in range(len(rows))]
    (folder / "frames.csv").write_text("\n".join(["frame,t,camera,image", *frames]) + "\n")
    numbers = [",".join(f"{value:.10f}" for value in row) for row in seen.seen]
    (folder / "poses.csv").write_text(
        "\n".join(["frame,x,y,z,rx,ry,rz", *(f"{k},{row}" for k, row in enumerate(numbers))]) + "\n"
    )


def rig_toml(platform):
    m = mechanism(platform)
    place = ", ".join(f"{x:g}" for x in m.home.translation)
    rows = {name: json.dumps(getattr(m, name).tolist()) for name in ("base_joints", "platform_joints", "strut_range")}
    return (
        'schema = "rig/1"\nname = "sprung"\n[environment]\ngravity = [0.0, 0.0, -9.80665]\n[mechanism]\n'
        + 'kind = "hexapod"\n'
        + "".join(f"{name} = {value}\n" for name, value in rows.items())
        + f"home = {{ position = [{place}], rotvec = [0.0, 0.0, 0.0] }}\n"
        + f"followers = {[one + 1 for one in m.followers]}\n"
        + '[actuator]\n[platform]\n[instrument]\nbase = "rig"\ntool = "rig"\n'
        + f"position_sigma = {POSE[0]}\nrotation_sigma = {POSE[3]}\n"
    )


@pytest.mark.slow
@pytest.mark.parametrize("struts", [7, 8])
def test_commands_calibrate_to_the_bound_and_leave_no_avoidable_force(struts, tmp_path):
    """Calibrated and corrected by the commands: errors at poses never used, and internal forces there."""
    squares, least, forces = [], [], []
    for seed in range(4):
        rng, owner = np.random.default_rng([struts, seed]), sprung_platforms.stated(struts)
        true, folder = sprung_platforms.drawn(struts, rng), tmp_path / str(seed)
        folder.mkdir()
        seen = sprung_platforms.measured(true, 200, POSE, STRUT, rng)
        recording(folder / "REC", rig_toml(owner), seen)
        run("calibrate", folder / "REC", "--quick", "--out", folder / "c.json")
        wanted = sprung_platforms.somewhere(NEVER_USED, rng)
        table = [f"{k}," + ",".join(f"{value:.12f}" for value in row) for k, row in enumerate(wanted)]
        (folder / "wanted.csv").write_text("\n".join(["frame,x,y,z,rx,ry,rz", *table]) + "\n")
        run("correct", folder / "c.json", "--poses", folder / "wanted.csv", "--out", folder / "commands.csv")
        commands = np.loadtxt(folder / "commands.csv", delimiter=",", skiprows=1)[:, 1:]
        miss = poses(wanted).inv() * poses(true.rests(commands))
        error = pose_to_vector(miss)
        squares.append([(error[:, :3] ** 2).sum(axis=1).mean(), (error[:, 3:] ** 2).sum(axis=1).mean()])
        least.append(np.square(true.pose_bound(wanted, true.bound(seen.rows, POSE, STRUT))))
        scatter = STRUT * rng.normal(size=commands.shape)
        forces.append(
            [bears(true, some + scatter)[0] for some in (owner.lengths(wanted), commands, true.lengths(wanted))]
        )
        remeasured = sprung_platforms.measured(true, 60, POSE, STRUT, rng)
        recording(folder / "NEW", rig_toml(owner), remeasured)
        output = json.loads(run("verify", folder / "c.json", folder / "NEW", "--json").stdout)["strut_conflict"]
        np.testing.assert_allclose([output["before"], output["after"]], forces[-1][:2], rtol=0.3)
    of_bound = np.sqrt(np.mean(squares, axis=0) / np.mean(least, axis=0))
    before, after, unavoidable = np.sqrt(np.mean(np.square(forces), axis=0))
    print(
        f"{struts} struts: {of_bound.round(3)} of the bound; forces {before / unavoidable:.1f} ->"
        f" {after / unavoidable:.3f} times the unavoidable part"
    )
    assert (of_bound < 1.2).all() and before > 15 * unavoidable and after < 1.1 * unavoidable


def test_what_more_struts_do_not_take_is_refused_with_a_reason(tmp_path):
    rng = np.random.default_rng(1)
    owner = sprung_platforms.stated(8)
    seen, m = sprung_platforms.measured(sprung_platforms.drawn(8, rng), 10, POSE, STRUT, rng), mechanism(owner)
    with pytest.raises(RigError, match="all 8 struts are driven.*named as followers"):
        identify_platform(samples(seen), mechanism(owner, followers=False))
    with pytest.raises(RigError, match="this is for six struts, and this platform has 8"):
        require_hexapod(m)
    with pytest.raises(ValueError, match="six struts at most"):
        Chain((m, m))
    with pytest.raises(ValueError, match="expected 2 of 8 struts"):
        Hexapod(m.base_joints, m.platform_joints, m.strut_range, m.home, followers=(1,))
    path, text = tmp_path / "rig.toml", rig_toml(owner)
    path.write_text(text)
    design = load_design(path)
    assert design.mechanism.followers == (2, 7) and design.mechanism.axes[-1] == "l8"
    with pytest.raises(RigError, match="grid moves all axes independently"):
        build_plan(design, "grid:2")
    ladder = build_plan(design, "ladder:2").commands.values
    np.testing.assert_allclose(
        redundant_strut_best_six_legs_and_loop_closures.incompatible_strut_length_component(
            hexapod.forward(ladder, m), ladder, m
        ),
        0,
        atol=2e-7,
    )
    (planned,) = command_unit_mistakes(Commands(np.arange(len(ladder)) * 1.0, ladder), design)
    assert "l3 and l8" in planned.what and not planned.spoils
    read = ladder + np.eye(8)[2] * 1e-4
    assert not list(command_unit_mistakes(Commands(np.arange(len(ladder)) * 1.0, read), design))
    for wrong in ("[3]", "[3, 9]", "[3, 3]", "3", "[true, 3]"):
        path.write_text(text.replace("[3, 8]", wrong))
        with pytest.raises(RigError, match="lists the numbers, from 1, of the 2 struts beyond six"):
            load_design(path)
    path.write_text(text + '[controller]\nprotocol = "grblhal"\nport = "loop://"\n')
    with pytest.raises(RigError, match=r"\[controller\] drives six struts, and this platform has 8"):
        load_design(path)
