"""A base or tool that is placed anew in each recording of an arm or chain: fitted, named and removed.

The machines, their kinematics and their displacements are an independent truth of plain matrices.
"""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.api.calibrate import CalibrateOptions, calibrate
from calib.api.certify import certify
from calib.api.diagnose import diagnose
from calib.api.recording_check_combination_and_view import check_and_combine_recordings
from calib.api.verify_and_watch import verify
from calib.models.arm.arm_certification import arm_correction_and_identification
from calib.models.arm.arm_error_model_and_instrument_observations import predicted_target_poses
from calib.samples.commanded_and_measured_pose_samples import sample_recording
from rig.cli import command_line
from rig.errors import RigError
from rig.recording.recording_folder import load_recording
from tests.truth.case import draw, recorded_anew
from tests.truth.rigid import displaced, errors, matrices, rows_of
from tests.truth.written import record

FAR = ([0.5, 1.0, 0.1, 0.1, 0.3, -1.0], [-0.4, 2.0, 0.2, -0.2, 0.5, 2.5])  # m, rad: a tracker that was moved
NEAR = ([11e-3, 5e-3, 1e-3, 1e-3, -4e-3, 2e-3], [2e-3, -3e-3, 0, 0, 1e-3, 0])
STILL = ([0.0] * 6, [0.0] * 6)
COUNT = 40


def written(case, folder, base=(0.0,) * 6, tool=(0.0,) * 6, ends=("rig", "rig"), alone=False):
    """Recording of a case seen from elsewhere. base, tool : (6,) m, rad; alone : whether positions alone are seen"""
    seen = rows_of(matrices(np.array([base])) @ matrices(case.seen) @ matrices(np.array([tool])))
    record(replace(case, seen=seen), folder)
    text = (folder / "rig.toml").read_text()
    for name, place in zip(("base", "tool"), ends):
        text = text.replace(f'{name} = "rig"', f'{name} = "{place}"')
    if alone:
        text = "\n".join(line for line in text.splitlines() if not line.startswith("rotation_sigma")) + "\n"
        rows = [line.split(",")[:4] for line in (folder / "poses.csv").read_text().splitlines()]
        (folder / "poses.csv").write_text("\n".join(map(",".join, rows)) + "\n")
    (folder / "rig.toml").write_text(text)
    return load_recording(folder)


def arm(seed):
    return draw(seed, effect="none", strength="none", kind="arm", count=COUNT)


def three(case, folder, places, **more):
    """Three recordings of a machine, the tracker moved between them."""
    cases = [case, *(_later(case, k) for k in (1, 2))]
    return [
        written(one, folder / f"rec{k}", base, **more) for k, (one, base) in enumerate(zip(cases, ([0.0] * 6, *places)))
    ]


def _later(case, number):
    return replace(recorded_anew(replace(case, seed=case.seed + 1000 * number)), seed=case.seed)


def combined(recordings):
    lines = []
    return check_and_combine_recordings(recordings, False, lines.append, None).recording, lines


def geometry_error(recording, case):
    """RMS error (m, rad) of a fitted arm's poses all over its travels, the best motion of its base taken out."""
    sampled = sample_recording(recording)
    _, found = arm_correction_and_identification(sampled.samples, recording.design.mechanism, sampled.instrument, False)
    rng, ranges = np.random.default_rng(1), case.owner.ranges
    q = rng.uniform(ranges[:, 0], ranges[:, 1], (200, len(ranges)))
    real, fitted = case.machine.forward(q), predicted_target_poses(q, found.arm).as_matrix()
    for _ in range(20):  # until the motion that agrees best is the identity
        turn, _ = Rotation.align_vectors(
            np.concatenate(np.swapaxes(real[:, :3, :3], 1, 2)), np.concatenate(np.swapaxes(fitted[:, :3, :3], 1, 2))
        )
        motion = np.eye(4)
        motion[:3, :3] = turn.as_matrix()
        motion[:3, 3] = (real[:, :3, 3] - fitted[:, :3, 3] @ motion[:3, :3].T).mean(axis=0)
        fitted = motion @ fitted
    off = errors(fitted, real)
    return np.sqrt([(off[:, :3] ** 2).sum(axis=1).mean(), (off[:, 3:] ** 2).sum(axis=1).mean()])


@pytest.mark.parametrize(
    ("places", "ends"),
    [
        pytest.param(FAR, ("free", "rig"), marks=pytest.mark.slow),
        (NEAR, ("rig", "rig")),
        pytest.param(STILL, ("free", "free"), marks=pytest.mark.slow),
    ],
)
def test_three_stations_tell_as_much_as_one(tmp_path, places, ends):
    """The same commands and noise, once from three stations and once from one: the geometry is as good."""
    moved, still = [], []
    for seed in range(3):
        case, folder = arm(seed), tmp_path / str(seed)
        joined, lines = combined(three(case, folder / "moved", places, ends=ends))
        assert sum("the base stands elsewhere" in line for line in lines) == (0 if places is STILL else 2)
        assert not any("tool stands elsewhere" in line for line in lines)
        moved.append(geometry_error(joined, case))
        one, _ = combined(three(case, folder / "still", STILL, ends=ends))
        still.append(geometry_error(replace(one, poses=replace(one.poses, common=None)), case))
    ratio = np.sqrt(np.square(moved).mean(axis=0) / np.square(still).mean(axis=0))
    assert (ratio <= 1.1).all() and (ratio >= 0.9).all(), ratio


def test_a_fit_still_solves_for_the_places(tmp_path):
    """What is uncertain of a place is an error that its recording's poses share, and none of the first one's."""
    case = arm(0)
    joined, _ = combined(three(case, tmp_path, NEAR))
    common = sample_recording(joined).samples.common
    assert common.shape == (3 * COUNT, 6, 12) and not common[:COUNT].any() and common[COUNT:].any()
    sizes = np.sqrt(np.einsum("nij,nij->ni", common, common))[COUNT:, :3]
    assert 0.05 * case.sigma[0] < sizes.mean() < 3 * case.sigma[0]  # some share of the noise, and no more


@pytest.mark.slow
@pytest.mark.parametrize("ends", [("rig", "rig"), ("free", "free")])
def test_a_verification_names_what_stands_elsewhere(tmp_path, ends):
    """Base and tool displaced for the verification: named within the stated interval, the errors back to the noise."""
    case = arm(3)
    station = np.array(FAR[0]) if ends[0] == "free" else np.zeros(6)  # where the arm stood when it was calibrated
    moved = rows_of(matrices(np.array([NEAR[0]])) @ matrices(station[None]))[0]
    first = written(draw(3, "none", "none", kind="arm", count=90), tmp_path / "a", station, ends=ends)
    calibration = calibrate(first, CalibrateOptions(quick=True)).calibration
    later = _later(case, 1)
    tool = [2e-3, 0, 1e-3, 1e-2, 0, 0]
    still = verify(calibration, written(later, tmp_path / "b", station, ends=ends))
    base = verify(calibration, written(later, tmp_path / "c", moved, ends=ends))
    hand = verify(calibration, written(later, tmp_path / "d", moved, tool, ends=ends))
    noise = still.figures.held.after.position[0]
    assert noise < 1.3 * np.sqrt(3) * case.sigma[0]
    stated = ends == ("rig", "rig")
    assert (still.figures.displacement == ()) == stated and not still.figures.unexpected
    assert base.figures.unexpected == (("base",) if stated else ())
    assert hand.figures.unexpected == (("base", "tool") if stated else ())
    motion = matrices(np.array([NEAR[0]]))[0]
    origin = calibration.correction.fitted.base.translation
    far = np.linalg.norm(motion[:3, :3] @ origin + motion[:3, 3] - origin)
    for found in (base, hand):
        position, rotation = found.placement.parts(0)
        assert abs(position.size - far) < 1.5 * position.U < 1e-4  # U is twice the standard uncertainty
        assert abs(rotation.size - np.linalg.norm(NEAR[0][3:])) < 1.5 * rotation.U < 1e-4
        assert found.figures.held.after.position[0] == pytest.approx(noise, rel=0.05)
        assert found.figures.found.kept and "the base stands elsewhere: by" in found.figures.displacement[0]
        assert ("the base stands elsewhere" in found.verdict.line) == stated
        assert found.tree()["placement"]["base"]["position"]["value"] == position.size
    _, rotation = hand.placement.parts(1)
    assert abs(rotation.size - 1e-2) < 1.5 * rotation.U < 1e-4


@pytest.mark.slow
def test_a_certificate_states_the_place(tmp_path):
    """A certificate's poses are without the displacement, which is stated on it."""
    calibration = calibrate(
        written(draw(3, "none", "none", kind="arm", count=60), tmp_path / "a"), CalibrateOptions(quick=True)
    ).calibration
    later = recorded_anew(draw(3, "none", "none", kind="arm", count=60))
    still = certify(calibration, written(later, tmp_path / "b"))
    moved = certify(calibration, written(later, tmp_path / "c", NEAR[0]))
    bound = still.certificate.promise.position.upper
    assert moved.certificate.promise.position.upper == pytest.approx(bound, rel=0.1)
    assert moved.tree()["displacement"][0].startswith("c: the base stands elsewhere: by 1")
    assert "the base stands elsewhere in c" in moved.verdict.line
    assert "displacement" not in still.tree()


@pytest.mark.slow
def test_positions_alone_and_a_chain(tmp_path):
    """A reflector on the hand, whose rotation nobody sees; and a platform on a slide."""
    joined, lines = combined(three(arm(5), tmp_path / "arm", FAR, ends=("free", "free"), alone=True))
    assert sum("the base stands elsewhere" in line for line in lines) == 2 and "tool" not in "".join(lines[1:])
    assert geometry_error_of_positions(joined, arm(5)) < 6 * arm(5).sigma[0]
    case = draw(0, effect="none", strength="none", kind="chain", count=COUNT)
    joined, lines = combined(three(case, tmp_path / "chain", NEAR))
    assert sum("the base stands elsewhere: by" in line for line in lines) == 2, lines
    seen = joined.poses.T_base_platform.as_matrix()
    real = np.concatenate([matrices(one.seen) for one in (case, _later(case, 1), _later(case, 2))])
    off = errors(seen, real)
    assert np.sqrt((off[:, :3] ** 2).mean()) < 3 * case.sigma[0]
    assert np.abs(off[:COUNT]).max() < 1e-10
    _, lines = combined(three(case, tmp_path / "still", STILL))
    assert "base and tool stand where they stood" in lines


def geometry_error_of_positions(recording, case):
    """Median distance (m) of the fitted arm's positions from the measured ones."""
    sampled = sample_recording(recording)
    _, found = arm_correction_and_identification(sampled.samples, recording.design.mechanism, sampled.instrument, False)
    predicted = predicted_target_poses(sampled.samples.commanded, found.arm).translation
    return float(np.median(np.linalg.norm(predicted - sampled.samples.T_base_platform.translation, axis=1)))


@pytest.mark.slow
def test_wild_poses_do_not_move_the_base(tmp_path):
    """Three poses of forty that somebody bumped are no displacement."""
    case = arm(3)
    calibration = calibrate(written(case, tmp_path / "a"), CalibrateOptions(quick=True)).calibration
    later, bump = _later(case, 1), np.zeros((COUNT, 6))
    bump[[4, 17, 31], 0] = 5e-3
    bumped = replace(later, seen=rows_of(displaced(matrices(later.seen), bump)))
    assert not verify(calibration, written(bumped, tmp_path / "b")).figures.displacement


@pytest.mark.slow
def test_wild_poses_do_not_grow_with_what_the_placement_takes(tmp_path):
    """Poses that were measured wrong are off by that much, are named, and refute nothing."""
    case, ends = arm(3), ("free", "free")
    calibration = calibrate(written(case, tmp_path / "a", ends=ends), CalibrateOptions(quick=True)).calibration
    later, bump = _later(case, 1), np.zeros((COUNT, 6))
    bump[[4, 17, 31], 0] = 5e-3
    seen = replace(later, seen=rows_of(displaced(matrices(later.seen), bump)))
    found = verify(calibration, written(seen, tmp_path / "b", ends=ends))
    assert found.figures.held.after.position[2] == pytest.approx(5e-3, rel=0.2)
    assert found.figures.found.far.frames == (4, 17, 31) and found.refutation is None
    assert found.verdict.line.startswith("check") and "(frames 4, 17, 31)" in found.verdict.line


def test_another_arms_poses_are_refused(tmp_path):
    """A recording of another arm is no displacement: its joint angles are not those of these poses."""
    case = arm(0)
    first, second = written(case, tmp_path / "a"), _later(case, 1)
    shuffled = replace(second, seen=second.seen[np.random.default_rng(0).permutation(COUNT)])
    with pytest.raises(RigError):
        combined([first, written(shuffled, tmp_path / "b", FAR[0])])


@pytest.mark.slow
def test_a_backlash_is_found_over_three_stations(tmp_path):
    """What joints do beyond their geometry is no displacement, and shows over recordings from three places."""
    case = draw(3, "backlash", "strong", kind="arm", count=25)
    found = diagnose(three(case, tmp_path, FAR, ends=("free", "free"))).report.findings
    (axis,) = np.flatnonzero(case.laws[0].axes)
    assert [(one.effect, one.place) for one in found] == [("backlash", f"joint {axis + 1}")]


@pytest.mark.slow
def test_the_command_line_states_the_place(tmp_path, capsys):
    """`rig verify` prints, writes and returns it; exit status 0, the verdict "check"."""
    written(draw(3, "none", "none", kind="arm", count=40), tmp_path / "a")
    written(_later(arm(3), 1), tmp_path / "b", NEAR[0])
    file = tmp_path / "calibration.json"
    assert run("calibrate", tmp_path / "a", "--out", file, "--quick") == 0
    capsys.readouterr()
    page = tmp_path / "v.html"
    assert run("verify", file, tmp_path / "b", "--page", page) == 0
    out = capsys.readouterr().out
    assert out.startswith("check: ") and "the base stands elsewhere: by 1" in out and "6 numbers were estimated" in out
    assert "The base stands elsewhere: by 1" in page.read_text()
    assert run("verify", file, tmp_path / "b", "--json") == 0
    placement = json.loads(capsys.readouterr().out)["placement"]
    assert placement["base"]["stands_elsewhere"] and "tool" not in placement


def run(*words):
    return command_line.main([str(word) for word in words])


@pytest.mark.slow
def test_what_the_numbers_took_of_the_noise_is_given_back(tmp_path):
    """Twelve numbers of ten poses take a fifth of their noise: the stated errors have all of it, in the mean."""
    first = draw(3, "none", "none", kind="arm", count=90)
    ends = ("free", "free")
    calibration = calibrate(written(first, tmp_path / "a", ends=ends), CalibrateOptions(quick=True)).calibration
    squares = []
    for k in range(20):
        few = _later(replace(first, journey=replace(first.journey, looked=first.journey.looked[:10])), k + 1)
        found = verify(calibration, written(few, tmp_path / f"b{k}", NEAR[0], ends=ends)).figures
        assert found.held.after.n == 10 and "12 numbers were estimated from these 10" in found.displacement[-1]
        squares.append(found.held.after.position[0] ** 2 / (3 * first.sigma[0] ** 2))
    assert 0.88 < np.mean(squares) < 1.25, np.mean(squares)
