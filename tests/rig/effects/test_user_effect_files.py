"""Effects of a user's own: a file is one of the catalogue's kind, and what is wrong with it is told with file and
line.
"""

import hashlib
import pickle
import re
from dataclasses import replace

import numpy as np
import pytest

from rig.cli.command_line import main
from rig.effects.catalogue.effect_list import ALL, effect_catalogue_with_user_files
from rig.effects.framework.effect_base_class import Effect
from rig.effects.texts.effect_text_parsing_and_user_effect_file_loading import load_effect_file, parse_effect
from rig.errors import FileError
from rig.formats.machine_geometry_and_effects_json_file import effect_from_dict, effect_to_dict
from rig.model import machine_motion_simulation as motion_simulation
from tests.conftest import ROOT
from tests.rig.effects.test_effects_of_all_machines import context_of, setting_of

SOUND = '''"""A coupling."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from rig.effects.base import Effect, Motion, Parameter


@dataclass(frozen=True, slots=True)
class Mine(Effect):
    """Deviation size * sin(90 * q), q the travel of strut 2."""

    place: str
    size: float = 0.0
    name: ClassVar = "mine"
    stage: ClassVar = "struts"
    places: ClassVar = ("axis",)
    parameters: ClassVar = (Parameter("size", "m", (-1e-2, 1e-2), (3e-6, 1e-4), signed=True),)
    experiment: ClassVar = "move strut 2 alone"
    action: ClassVar = "Look at what ties the {axis} to strut 2."

    def deviation(self, motion: Motion) -> np.ndarray:
        return self.axes(motion.places) * self.size * np.sin(90 * motion.stroke[:, [1]])
'''
HOOK = "        return self.axes(motion.places) * self.size * np.sin(90 * motion.stroke[:, [1]])\n"
WRONG = [  # what stands in place of what, what is said of it
    ("import numpy as np", "import numpy as np oh", "mine.py:6:.*no Python"),
    ("import numpy as np", "import nothing_of_the_kind", "mine.py:6: cannot be run: ModuleNotFoundError"),
    ("(Effect)", "", "mine.py: defines no effect"),
    ("frozen=True, ", "", "mine.py:12: Mine must be a frozen dataclass"),
    (
        'name: ClassVar = "mine"',
        'name: ClassVar = "backlash"',
        "mine.py:12: Mine collides with the catalogue's backlash",
    ),
    ('name: ClassVar = "mine"', 'name: ClassVar = "My own"', "mine.py:12: .*small letters"),
    ('"struts"', '"somewhere"', "mine.py:12: .*stage 'somewhere'"),
    ('("axis",)', '("leg",)', "mine.py:12: .*sits at"),
    ('("axis",)', '"axis"', "mine.py:12: .*sits at"),
    ("size: float = 0.0", "size: float", "mine.py:12: .*no default"),
    ('"size", "m"', '"sise", "m"', "mine.py:12: .*fields place, size"),
    ("signed=True)", 'role="strange")', "mine.py:12: .*role 'strange'"),
    ("(3e-6, 1e-4)", "(0, 0)", "mine.py:12: .*how large size usually is"),
    ('"""Deviation size * sin(90 * q), q the travel of strut 2."""', "", "mine.py:12: .*no docstring"),
    ('action: ClassVar = "Look', 'remark: ClassVar = "Look', "mine.py:12: .*nothing of its action"),
    ("def deviation(", "def deviates(", "mine.py:12: .*does nothing"),
]
FAILS = [  # the model, what is said of it
    ("        return self.size / 0 * motion.stroke\n", "mine.py:25: mine.deviation fails: ZeroDivisionError"),
    (
        "        return self.size * motion.stroke[:, 0]\n",
        r"mine.py:24: mine.deviation answers numbers of shape \(60,\).*\(60, 6\)",
    ),
    ("        return self.size * np.inf + motion.stroke\n", "mine.py:24: .*no finite number"),
    (
        "        return 1e-6 + self.size * motion.stroke\n",
        "mine.py:12: mine changes something with its parameters at their defaults",
    ),
]


def written(folder, old="", new=""):
    assert old in SOUND
    (folder / "mine.py").write_text(SOUND.replace(old, new, 1) if old else SOUND)
    return folder / "mine.py"


@pytest.mark.parametrize("name", ["bend", "times", "late", "at", "axes", "values", "form", "_places"])
def test_a_parameter_is_not_called_as_a_hook_or_attribute_of_every_effect(tmp_path, name):
    path = tmp_path / "mine.py"
    path.write_text(
        SOUND.replace("    size: float", f"    {name}: float")
        .replace('("size"', f'("{name}"')
        .replace("self.size", f"self.{name}")
    )
    with pytest.raises(FileError, match=rf"mine.py:16: Mine has a parameter '{name}'"):
        load_effect_file(path)


PAGE = (ROOT / "docs" / "own-effects.md").read_text(encoding="utf-8")


def test_the_effects_of_the_page_are_effects(tmp_path, design):
    texts = re.findall(r"^```python\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)
    found = []
    for text in texts:
        (tmp_path / "mine.py").write_text(text)
        found += load_effect_file(tmp_path / "mine.py").kinds
    mine, bearing = found
    assert mine.parameters_at("joint 2") == mine.parameters_at("strut 2")  # no figures of its own at a joint
    strut, joint, slide = (bearing.parameters_at(place)[0] for place in ("strut 2", "joint 2", "slide 2"))
    assert (strut.unit, strut.usual) == ("m", (2e-6, 5e-5)) and slide == strut
    assert (joint.unit, joint.bounds, joint.usual) == ("rad", (-1e-2, 1e-2), (2e-5, 1e-3))
    assert bearing.action_at("joint 2") == "Exchange the bearing of the joint."
    setting = setting_of(design, "hexapod")
    still, moved = (
        motion_simulation.simulate_machine_run(*setting[:3], [bearing("strut 3", height=height)], setting[3])
        for height in (0.0, 1e-4)
    )
    difference = moved.deviation - still.deviation
    assert difference[:, 2].any() and not np.delete(difference, 2, axis=1).any()


def test_no_effect_of_the_catalogue_calls_a_parameter_so():
    assert [(kind.name, p.name) for kind in ALL for p in kind.parameters if hasattr(Effect, p.name)] == []


def test_a_sound_file_is_an_effect_like_any_other(tmp_path, design):
    path = written(tmp_path)
    plugin = load_effect_file(path)
    known = effect_catalogue_with_user_files((plugin,))
    assert (
        list(known) == [*(kind.name for kind in ALL), "mine"]
        and plugin.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()
    )
    effect = parse_effect("mine:strut3:size=2e-5", known)
    assert effect_from_dict(effect_to_dict(effect), known) == effect
    setting = setting_of(design, "hexapod")
    done = motion_simulation.simulate_machine_run(*setting[:3], [effect], setting[3])
    stroke = context_of(setting).moved().stroke
    np.testing.assert_allclose(done.deviation, 2e-5 * np.sin(90 * stroke[:, [1]]) * (np.arange(6) == 2), atol=1e-18)


@pytest.mark.parametrize("old, new, message", WRONG, ids=[message for *_, message in WRONG])
def test_what_is_wrong_with_a_file_is_told_with_its_line(tmp_path, old, new, message):
    with pytest.raises(FileError, match=message):
        load_effect_file(written(tmp_path, old, new))


@pytest.mark.parametrize("model, message", FAILS, ids=[message for _, message in FAILS])
def test_a_model_that_fails_is_told_with_its_line(tmp_path, design, model, message):
    (kind,) = load_effect_file(written(tmp_path, HOOK, model)).kinds
    context = context_of(setting_of(design, "hexapod"))
    with pytest.raises(FileError, match=message) as raised:
        kind("strut 1", 1e-5).deviation(context.moved())
        kind.sites(context)
    assert message.split(":")[1] == str(
        pickle.loads(pickle.dumps(raised.value)).line
    )  # as a process of its own hands it on


def test_two_files_do_not_share_a_name(tmp_path):
    first = load_effect_file(written(tmp_path))
    (tmp_path / "other.py").write_text(SOUND)
    with pytest.raises(FileError, match="other.py:12: there is an effect 'mine' already, in .*mine.py"):
        effect_catalogue_with_user_files((first, load_effect_file(tmp_path / "other.py")))


def test_a_file_that_is_none_is_refused(tmp_path):
    with pytest.raises(FileError, match="nothing.py: cannot be read: No such file"):
        load_effect_file(tmp_path / "nothing.py")
    (tmp_path / "half.py").write_bytes(SOUND[:900].encode() + b"\n\xff")
    with pytest.raises(FileError, match=r"half.py:\d+: is not text in UTF-8"):
        load_effect_file(tmp_path / "half.py")


def test_commands_take_the_file(tmp_path, rig_text, capsys):
    (tmp_path / "rig.toml").write_text(rig_text)
    path, options = written(tmp_path), ["--plan", "sobol:3", "--effect", "mine:strut3:size=2e-5"]
    simulate = [
        "simulate",
        str(tmp_path / "rig.toml"),
        *options,
        "--truth",
        str(tmp_path / "truth.json"),
        "--out",
        str(tmp_path / "rec"),
    ]
    assert main(simulate) == 1 and "there is no effect 'mine'" in capsys.readouterr().err
    assert (
        main([*simulate, "--effects", str(tmp_path)]) == 1
        and "cannot be read: Is a directory" in capsys.readouterr().err
    )
    assert main([*simulate, "--effects", str(path)]) == 0 and "mine at strut 3" in capsys.readouterr().out
    second_command = [
        *simulate[:2],
        "--plan",
        "sobol:3",
        "--machine",
        str(tmp_path / "truth.json"),
        "--out",
        str(tmp_path / "again"),
    ]
    assert main(second_command) == 1 and "truth.json" in capsys.readouterr().err
    assert main([*second_command, "--effects", str(path)]) == 0


def test_a_model_may_look_at_where_the_platform_is_and_which_way_it_came(design):
    motion = context_of(setting_of(design, "hexapod")).moved()
    home, T = design.mechanism.home, motion.poses()
    np.testing.assert_allclose(motion.displaced[:, :3], T.translation - home.translation, atol=1e-9)
    np.testing.assert_allclose(motion.displaced[:, 3:], (T.rotation * home.rotation.inv()).as_rotvec(), atol=1e-9)
    assert not replace(motion, T=type(home).concatenate([home])).displaced.round(9).any()
    steps = np.diff(motion.path.lengths, axis=0)
    for i, at in ((0, motion.path.at[-1]), (3, motion.path.at[20])):
        own = steps[:at, i]
        assert motion.path.direction[list(motion.path.at).index(at), i] == np.sign(own[own != 0][-1])
