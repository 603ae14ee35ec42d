"""Links of an arm that bend and twist, added up piece by piece by a second writer: the effect does the same, and a
diagnosis names the link, and not a joint that yields.
"""

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

import rig
from calib.api.calibrate import CalibrateOptions, calibrate
from calib.api.correct import CorrectOptions, correct
from calib.api.diagnose import diagnose
from rig.effects.texts.effect_text_parsing_and_user_effect_file_loading import parse_effect
from rig.errors import RigError
from rig.model.design import Actuator, Design, Platform
from rig.model.design import Arm as DesignArm
from rig.model.machine_motion_simulation import simulate_machine_run
from rig.recording.recording_folder import PAYLOAD, Commands, Sensors
from tests.truth.bending import DOWN, bent_arm
from tests.truth.draw_machines import nominal, secret
from tests.truth.kinematics import Arm
from tests.truth.rigid import errors, rms
from tests.truth.written import _mechanism, table

MASS, CENTRE = 12.0, np.array([0.05, 0.02, 0.25])  # kg, m in the hand's frame
SIGMA, TURN = 3e-5, 5e-5  # m and rad, noise of each coordinate and angle
BEAM, OPEN, SPRING = (2e4, 1.54e4), (2e4, 2e3), 4e4  # (E I, G J) N m^2 of a tube and an open section, N m/rad
SLIDING = Arm(  # a turning column with a ram that comes out of it, and a wrist
    np.array([[0.0, 0.5, 0.0, np.pi / 2], [0.0, 0.3, 0.0, -np.pi / 2], [0.0, 0.1, 0.2, 0.3]]),
    np.array([False, True, False]),
    np.zeros(3),
    np.array([[-2.0, 2.0], [0.0, 0.6], [-1.5, 1.5]]),
    np.zeros(3),
)


def yielded(machine: Arm, q: np.ndarray, springs: dict[int, float]) -> np.ndarray:
    """Joint values at which joints {from 1: N m/rad} have yielded to the load, commanded q (n, 6)."""
    out = q.copy()
    for joint, stiffness in springs.items():
        step = 1e-5 * np.eye(6)[joint - 1]
        high, low = (-MASS * (machine.forward(at) @ np.r_[CENTRE, 1.0])[:, :3] @ DOWN for at in (q + step, q - step))
        out[:, joint - 1] -= (high - low) / 2e-5 / stiffness
    return out


class Tracked:
    """An owner's arm under a tracker, some links of which bend and some joints of which yield: {joint from 1: ..}."""

    def __init__(self, seed, beams, springs):
        self.rng, self.beams, self.springs = np.random.default_rng(seed), beams, springs
        self.owner = nominal("arm", self.rng)
        self.real = secret(self.owner, 3e-4, self.rng)
        self.middle, self.half = self.owner.ranges.mean(axis=1), 0.475 * np.ptp(self.owner.ranges, axis=1)

    def stands(self, q):
        """(n, 4, 4) at commands (n, 6)."""
        return bent_arm(self.real, yielded(self.real, q, self.springs), (MASS, CENTRE), self.beams)

    def recorded(self, folder, count=120):
        """Its recording at random commands."""
        rng = self.rng
        q, t = self.middle + self.half * rng.uniform(-1, 1, (count, 6)), 7.0 * np.arange(count)
        poses = self.stands(q)
        folder.mkdir()
        platform = ["[platform]", f"mass = {MASS}", f"centre_of_mass = {CENTRE.tolist()}"]
        ends = ["[instrument]", 'base = "rig"', 'tool = "rig"', f"position_sigma = {SIGMA}", f"rotation_sigma = {TURN}"]
        head = ['schema = "rig/1"', "[environment]", f"gravity = {DOWN.tolist()}"]
        (folder / "rig.toml").write_text("\n".join([*head, *_mechanism(self.owner), *platform, *ends]))
        commands = np.column_stack([np.r_[t, t[-1] + 5], np.r_[q, q[-1:]]])
        table(folder / "commands.csv", ("t", *self.owner.names), commands)
        frames = "".join(f"{k},{a},,\n" for k, a in enumerate(t))
        (folder / "frames.csv").write_text("frame,t,camera,image\n" + frames)
        turned = Rotation.from_matrix(poses[:, :3, :3]) * Rotation.from_rotvec(TURN * rng.normal(size=(count, 3)))
        seen = poses[:, :3, 3] + SIGMA * rng.normal(size=(count, 3))
        rows = np.column_stack([np.arange(count), seen, turned.as_rotvec()])
        table(folder / "poses.csv", ("frame", "x", "y", "z", "rx", "ry", "rz"), rows)
        return rig.load(folder)


def simulated(arm, q, texts, platform, payload=0.0):
    """(n, 4, 4) by the package, of an arm of the second writer."""
    joints = np.column_stack([arm.rows, arm.tilts])
    joints[:, 0] += np.where(arm.slides, 0, arm.zeros)
    mechanism = DesignArm(joints, arm.ranges, slides=arm.slides)
    design = Design("arm", DOWN, mechanism, None, Actuator(0.004, None, None), platform, (), ())
    t = np.arange(float(len(q)))
    log = Sensors(np.zeros(1), {PAYLOAD: np.full(1, payload)})
    return simulate_machine_run(design, Commands(t, q), t, [parse_effect(text) for text in texts], log).T_base_platform


@pytest.mark.parametrize("links", [{2: BEAM}, {3: OPEN}, {1: OPEN, 2: BEAM}, {4: BEAM}])
@pytest.mark.parametrize("payload", [0.0, 5.0])
def test_an_end_turns_and_moves_as_its_pieces_add_up_to(links, payload):
    rng = np.random.default_rng(2)
    arm = nominal("arm", rng)
    q = rng.uniform(*arm.ranges.T, (20, 6))
    texts = [f"link_bending:joint{joint}:stiffness={a},torsion={b / a}" for joint, (a, b) in links.items()]
    found = simulated(arm, q, texts, Platform(MASS, CENTRE, CENTRE), payload)
    straight = arm.forward(q)
    expected = errors(bent_arm(arm, q, (MASS + payload, CENTRE), links), straight)
    off = np.abs(errors(found.as_matrix(), straight) - expected).max()
    assert off < 4e-3 * np.abs(expected).max() and np.abs(expected).max() > 2e-4


def test_a_slide_bends_more_the_farther_it_is_out():
    rng = np.random.default_rng(3)
    q = rng.uniform(*SLIDING.ranges.T, (20, 3))
    found = simulated(SLIDING, q, ["link_bending:slide2:stiffness=2e4"], Platform(MASS, CENTRE, None))
    straight = SLIDING.forward(q)
    expected = errors(bent_arm(SLIDING, q, (MASS, CENTRE), {2: (2e4, 0.77 * 2e4)}), straight)
    off = np.abs(errors(found.as_matrix(), straight) - expected).max()
    assert off < 4e-3 * np.abs(expected).max()
    out = np.tile([[0.5, 0.0, 0.0]], (2, 1)) + [[0, 0, 0], [0, 0.6, 0]]
    ends = simulated(SLIDING, out, ["link_bending:slide2:stiffness=2e4"], Platform(MASS, CENTRE, None)).as_matrix()
    near, far = np.linalg.norm((ends - SLIDING.forward(out))[:, :3, 3], axis=1)
    assert far > 3 * near


def test_a_link_without_a_length_or_a_load_is_refused():
    arm, q = nominal("arm", np.random.default_rng(2)), np.zeros((1, 6))
    with pytest.raises(RigError, match="takes a link that has a length"):
        simulated(arm, q, ["link_bending:joint5:stiffness=2e4"], Platform(MASS, CENTRE, None))
    with pytest.raises(RigError, match="needs .platform. mass"):
        simulated(arm, q, ["link_bending:joint2:stiffness=2e4"], Platform(None, None, None))


HIDDEN = [  # seed, beams, springs
    (2, {2: BEAM}, {}),
    (2, {2: OPEN}, {}),
    (2, {4: BEAM}, {}),
    (2, {}, {2: SPRING}),
    (2, {}, {3: SPRING}),
    (2, {2: BEAM}, {2: SPRING}),
    (2, {2: BEAM}, {3: SPRING}),
    (4, {2: BEAM, 4: BEAM}, {2: SPRING, 3: SPRING}),  # one by one, link 1 is admitted in place of others
]


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "beams", "springs"), HIDDEN)
def test_a_bending_link_and_a_yielding_joint_are_told_apart(tmp_path, seed, beams, springs):
    report = diagnose(Tracked(seed, beams, springs).recorded(tmp_path / "REC")).report
    hidden = {("link_bending", f"joint {joint}"): stiffness for joint, (stiffness, _) in beams.items()}
    hidden |= {("compliance", f"joint {joint}"): stiffness for joint, stiffness in springs.items()}
    assert {(one.effect, one.place) for one in report.findings} == set(hidden)
    for one in report.findings:
        value = one.parameters["stiffness"]
        low, high = value.ci95
        assert low - (high - low) / 2 <= hidden[one.effect, one.place] <= high + (high - low) / 2
        assert high - low < 0.15 * value.value and not one.cannot_be_told_from
    assert report.unexplained is None


@pytest.mark.slow
@pytest.mark.parametrize("seed", [2, 3])
def test_a_link_that_bends_less_than_the_noise_is_one_of_those_stated(tmp_path, seed):
    report = diagnose(Tracked(seed, {2: (4e5, 3.1e5)}, {}).recorded(tmp_path / "REC")).report
    (found,) = report.findings
    others = [(one.effect, one.place) for one in found.cannot_be_told_from]
    assert ("link_bending", "joint 2") in [(found.effect, found.place), *others] and others


@pytest.mark.slow
def test_what_bends_is_made_up_for(tmp_path):
    tracked = Tracked(4, {2: BEAM, 4: BEAM}, {3: SPRING})
    recording = tracked.recorded(tmp_path / "REC")
    (tmp_path / "found").mkdir()
    diagnose(recording).write(tmp_path / "found")
    goal = tracked.owner.forward(tracked.middle + 0.8 * tracked.half * tracked.rng.uniform(-1, 1, (60, 6)))
    left = []
    for options in (CalibrateOptions(diagnosis=tmp_path / "found", quick=True), CalibrateOptions(quick=True)):
        calibration = calibrate(recording, options).calibration
        commands = correct(calibration, RigidTransform.from_matrix(goal), CorrectOptions()).values
        left.append(rms(errors(tracked.stands(np.asarray(commands)), goal))[0])
    print(f"error {left[0] * 1e6:.1f} um with the effects found, {left[1] * 1e6:.1f} um without")
    assert left[0] < SIGMA and left[0] < left[1] / 5
