"""Laws that every mechanism keeps, over the tuple of them all, and what the hexapod promises besides."""

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from rig.errors import NotConverged, RigError
from rig.formats.rig_toml.design_from_rig_toml import load_design
from rig.model.design import Planar2
from rig.model.mechanisms import ALL, hexapod, kinematics_of
from rig.model.pose import exp, pose
from tests.conftest import ROOT
from tests.numerical_derivatives import jacobian

PARALLEL = [
    kind for kind in ALL if kind not in ("arm", "chain")
]  # they answer to joint values, chains by choice: test_arm, test_chains
CRANKS = load_design(ROOT / "docs" / "kinematics" / "cranks.toml").mechanism
PLANAR = Planar2([[0.0, 0.0], [1.0, 0.0]], [[0.6, 1.2], [0.6, 1.2]], [1e-3, -2e-3])


def samples(kind, design, shape, rng):
    mechanism = {"hexapod": design.mechanism, "planar2": PLANAR, "file": CRANKS}[kind]
    low, high = kinematics_of(mechanism).travel_ranges(mechanism).T
    return mechanism, low + (high - low) * rng.uniform(0.05, 0.95, (*shape, len(low)))


@pytest.mark.parametrize("kind", PARALLEL)
@pytest.mark.parametrize("shape", [(), (1,), (50,), (2, 3, 4)])
def test_inverse_of_forward_is_the_identity(kind, shape, design):
    mechanism, lengths = samples(kind, design, shape, np.random.default_rng(0))
    T = kinematics_of(mechanism).forward(lengths, mechanism)
    assert T.shape == shape
    np.testing.assert_allclose(kinematics_of(mechanism).inverse(T, mechanism), lengths, atol=1e-10)


@pytest.mark.parametrize("kind", PARALLEL)
def test_jacobian_agrees_with_differences(kind, design):
    mechanism, lengths = samples(kind, design, (), np.random.default_rng(1))
    module = kinematics_of(mechanism)
    T = module.forward(lengths, mechanism)
    np.testing.assert_allclose(
        module.jacobian(T, mechanism),
        jacobian(lambda xi: module.inverse(T * exp(xi), mechanism), np.zeros(6)),
        atol=1e-8,
    )


@pytest.mark.parametrize("kind", PARALLEL)
def test_limits_are_signed_and_zero_inside(kind, design):
    mechanism, lengths = samples(kind, design, (), np.random.default_rng(2))
    module = kinematics_of(mechanism)
    assert not module.signed_limit_excess(lengths, mechanism).any()
    low, high = module.travel_ranges(mechanism).T
    np.testing.assert_allclose(module.signed_limit_excess(high + 0.01, mechanism), 0.01)
    np.testing.assert_allclose(module.signed_limit_excess(low - 0.02, mechanism), -0.02)


def test_planar_forward_is_hand_worked():
    square = Planar2([[0.0, 0.0], [6.0, 0.0]], [[1, 9], [1, 9]])
    np.testing.assert_allclose(ALL["planar2"].forward([5.0, 5.0], square).translation, [3, 4, 0], atol=1e-12)


def test_planar_circles_that_do_not_meet_say_so():
    with pytest.raises(NotConverged, match="do not meet") as caught:
        ALL["planar2"].forward([[0.7, 0.7], [0.1, 0.1]], PLANAR)
    assert caught.value.index.tolist() == [1]


def test_zeros_are_what_a_strut_is_longer_than_its_command(design):
    from dataclasses import replace

    longer = replace(design.mechanism, strut_zeros=np.full(6, 1e-3))
    home = design.mechanism.home
    np.testing.assert_allclose(
        hexapod.inverse(home, design.mechanism) - hexapod.inverse(home, longer), 1e-3, atol=1e-15
    )


def test_home_lengths_are_hand_worked(design):
    m = design.mechanism
    gap = m.home.translation + m.platform_joints - m.base_joints
    np.testing.assert_allclose(hexapod.inverse(m.home, m), np.sqrt((gap**2).sum(axis=1)), atol=1e-15)


def test_forward_names_the_poses_it_cannot_solve(design):
    lengths = np.tile(hexapod.inverse(design.mechanism.home, design.mechanism), (3, 1))
    lengths[1] = [0.1, 5.0, 0.1, 5.0, 0.1, 5.0]
    with pytest.raises(NotConverged) as caught:
        hexapod.forward(lengths, design.mechanism)
    assert caught.value.index.tolist() == [1]
    assert caught.value.residual[0] > 1e-3
    assert "[0.1, 5.0" in str(caught.value)


def test_forward_refuses_another_assembly(design):
    m = design.mechanism
    below = pose([0, 0, -m.home.translation[2]], [0, 0, 0])
    assert hexapod.forward(hexapod.inverse(below, m), m).translation[2] > 0  # by symmetry home has these lengths too
    beyond = pose([-0.25, -0.11, 0.46], [-0.11, 1.58, -0.16])  # from here Newton crosses a singularity
    with pytest.raises(NotConverged, match="another assembly"):
        hexapod.forward(hexapod.inverse(m.home, m), m, guess=beyond)


def test_forward_near_a_singular_pose_is_exact_or_refuses(design):
    m = design.mechanism
    rng = np.random.default_rng(3)
    for turn in np.linspace(1.2, 1.57, 15):  # a quarter turn about z makes this kind of hexapod singular
        T = pose([0, 0, 0.4], [0, 0, turn]) * exp(1e-3 * rng.normal(size=6))
        try:
            found = hexapod.forward(hexapod.inverse(T, m), m, guess=T * exp(1e-4 * rng.normal(size=6)))
        except NotConverged:
            continue
        np.testing.assert_allclose(hexapod.inverse(found, m), hexapod.inverse(T, m), atol=1e-10)


def test_forward_refuses_what_is_no_length(design):
    with pytest.raises(ValueError, match="finite lengths"):
        hexapod.forward(np.full(6, np.nan), design.mechanism)
    with pytest.raises(ValueError, match="shape"):
        hexapod.forward(np.ones(5), design.mechanism)


def test_a_kind_without_kinematics_is_named():
    from rig.model.design import Free

    with pytest.raises(RigError, match="'free'"):
        kinematics_of(Free())


def test_identity_batches_are_rigid_transforms(design):
    assert isinstance(
        hexapod.forward(hexapod.inverse(design.mechanism.home, design.mechanism), design.mechanism), RigidTransform
    )
