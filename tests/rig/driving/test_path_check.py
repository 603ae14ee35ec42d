"""Ranges and paths that the driver accepts: chains stage by stage, joints that follow others."""

import numpy as np
import pytest

from rig.driving.move_profiles_and_path_check import jog_goal, require_axis_values_in_range, require_safe_path
from rig.errors import Unreachable
from rig.model.arm_hands_effect_places_and_tolerances import Coupling
from rig.model.mechanism_geometry_classes import Arm, Chain

SLIDES = Arm(np.zeros((2, 4)), [[-0.1, 0.1]] * 2, slides=np.ones(2))
TO = np.array([8e-3, -8e-3, 0, 0, 0, 0])  # m from mid-travel


@pytest.mark.parametrize(("factor", "margin", "words"), [(1.0, 1.0, "singularity"), (1e-3, 0.1, "workspace.*units")])
def test_a_stage_on_struts_is_checked_as_the_platform_alone(driven_design, factor, margin, words):
    platform = driven_design.mechanism
    middle = platform.strut_range.mean(axis=1)
    start, target = factor * middle, middle + TO
    with pytest.raises(Unreachable, match=f"(?s){words}") as alone:
        require_safe_path(start, target, platform, margin, None)
    rest = np.zeros(2)
    with pytest.raises(Unreachable) as stacked:
        require_safe_path(np.r_[start, rest], np.r_[target, rest], Chain((platform, SLIDES)), margin, None)
    assert stacked.value.violations[0] == f"stage 1, {alone.value.violations[0]}"
    with pytest.raises(Unreachable, match="stage 2, "):
        require_safe_path(np.r_[rest, start], np.r_[rest, target], Chain((SLIDES, platform)), margin, None)
    require_safe_path(np.r_[rest, middle], np.r_[rest + 0.05, middle], Chain((SLIDES, platform)), 0.1, None)


@pytest.mark.parametrize("stacked", [False, True])
def test_joints_that_follow_others_go_where_their_leaders_have_them(driven_design, stacked):
    arm = Arm(np.zeros((3, 4)), [[-1, 1]] * 3, couplings=(Coupling(2, 0, -0.5, 0.1),))
    platform = driven_design.mechanism
    machine, below = (Chain((platform, arm)), platform.strut_range.mean(axis=1)) if stacked else (arm, [])
    name = f"{'stage 2 ' if stacked else ''}joint 3"

    def at(*q):
        return np.r_[below, q]

    unnamed = np.zeros(len(machine.axes), bool)
    goal = jog_goal(at(0.2, 0.3, 0.1), unnamed, machine)
    np.testing.assert_allclose(require_axis_values_in_range(goal, machine), at(0.2, 0.3, 0.0), atol=1e-15)
    named = unnamed | (np.arange(len(unnamed)) == len(below) + 2)
    with pytest.raises(Unreachable, match=f"{name}: 5.730 deg, its leader has it at 0.000 deg"):
        require_axis_values_in_range(jog_goal(at(0.2, 0.3, 0.1), named, machine), machine)
