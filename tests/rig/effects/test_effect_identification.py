"""Effects, places and plans named from outside: what the rig does not have is refused with the nearest that it has;
counts are bounded.
"""

from dataclasses import replace

import numpy as np
import pytest

from rig.effects.texts.effect_text_parsing_and_user_effect_file_loading import (
    effect_with_existing_place,
    parse_effect,
    require_known_effect,
)
from rig.errors import RigError
from rig.formats.machine_geometry_and_effects_json_file import effect_from_dict
from rig.model.design import Planar2
from rig.planning import recording_plan as plan


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("backlash:strut9:gap=1e-5", "this rig has no strut '9'.*it has 1, 2, 3, 4, 5, 6"),
        ("backlash:joint1:gap=1e-5", "has no joint '1'"),
        ("camera_bump:nosuch:motion=1e-4/0/0/0/0/0", "has no camera 'nosuch'"),
        ("camera_drift:cam11:motion=1e-4/0/0/0/0/0", "is 'cam1' meant"),
        ("face_misplacement:999:offset=1e-4/0/0", "has no marker '999'"),
        ("cube_misplacement:PX:motion=1e-4/0/0/0/0/0", "has no target 'PX'"),
        ("marker_swap:8:other=999", "has no marker '999'"),
    ],
)
def test_places_that_the_rig_lacks_are_refused(design, text, says):
    with pytest.raises(RigError, match=says):
        effect_with_existing_place(parse_effect(text), design)


def test_a_planar_rig_has_two_struts(design):
    planar = replace(design, mechanism=Planar2([[0.0, 0.0], [1.0, 0.0]], [[0.5, 1.5], [0.5, 1.5]]))
    assert effect_with_existing_place(parse_effect("backlash:strut2:gap=1e-5"), planar).place == "strut 2"
    with pytest.raises(RigError, match="it has 1, 2$"):
        effect_with_existing_place(parse_effect("backlash:strut3:gap=1e-5"), planar)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("backlsh", "is 'backlash' meant"),
        ("backlash strut 9", "no strut '9'"),
        ("marker_swap strut 8", "cannot sit at 'strut 8'"),
        ("backlash camera cam0", "cannot sit"),
        ("camera_bump camera cam9", "no camera 'cam9'"),
    ],
)
def test_a_diagnosis_is_asked_only_for_what_can_be(design, text, says):
    assert require_known_effect("backlash strut 2", design) and require_known_effect("marker_swap", design)
    with pytest.raises(RigError, match=says):
        require_known_effect(text, design)


@pytest.mark.parametrize(
    "tree",
    [
        0,
        [],
        {},
        {"effect": "backlash", "place": 0, "parameters": {}},
        {"effect": ["backlash"], "place": "strut 1", "parameters": {}},
        {"effect": "backlash", "place": "strut \u00b2", "parameters": {}},
        {"effect": "backlash", "place": "strut 1", "parameters": {"gap": 10**400}},
        {"effect": "backlash", "place": "strut 1", "parameters": {"gap": True}},
        {"effect": "backlash", "place": "strut 1", "parameters": {"gip": 1e-5}},
        {"effect": "camera_bump", "place": "camera a", "parameters": {"motion": [[1]] * 6}},
        {"effect": "lens_distortion", "place": "camera a", "parameters": {"warp": [0.1]}},
        {"effect": "transmission_error", "place": "strut 1", "parameters": {"profile": [1e-5]}},
    ],
)
def test_what_is_no_effect_is_refused(tree):
    with pytest.raises(RigError):
        effect_from_dict(tree)


@pytest.mark.parametrize(
    "text",
    [
        "grid:30",
        "sobol:10000000",
        "ladder:99999999",
        "sobol:\u00b2",
        "sobol:" + "9" * 5000,
        "sobol:00000000000009999999",
        ",".join(["sobol:19000"] * 2),
        "simplices:100000",
    ],
)
def test_plans_are_bounded_with_a_word(design, text):
    with pytest.raises(RigError, match="exposes|whole number"):
        plan.build_plan(design, text)
    assert np.isfinite(plan.build_plan(design, "sobol:00004").t).all()
