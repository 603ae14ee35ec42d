"""Whatever ends a command, what was there is as it was, nothing half stands under a final name, and the same command
works again.
"""

import random

import pytest

from tests import killed_commands


@pytest.fixture(scope="module")
def scenes(tmp_path_factory):
    return killed_commands.prepared(tmp_path_factory.mktemp("quick"), ("simulate",))


def test_killed(scenes, tmp_path):
    dice = random.Random(3)
    assert [killed_commands.killed(scenes[0], tmp_path / str(k), dice.uniform(0.6, 1.1)) for k in range(2)] == [""] * 2


@pytest.mark.skipif(not killed_commands.can_mount(), reason="takes root, for a disk of its own")
def test_on_a_full_disk(scenes, tmp_path):
    (tmp_path / "disk").mkdir()
    dice = random.Random(4)
    assert [killed_commands.starved(scenes[0], tmp_path / "disk", dice.randrange(120_000)) for _ in range(2)] == [
        ""
    ] * 2


@pytest.fixture(scope="module")
def all_scenes(tmp_path_factory):
    return killed_commands.prepared(tmp_path_factory.mktemp("all"), tuple(killed_commands.COMMANDS))


@pytest.mark.slow
def test_killed_a_hundred_times(all_scenes, tmp_path):
    dice = random.Random(1)
    wrong = [
        killed_commands.killed(dice.choice(all_scenes), tmp_path / str(k), dice.uniform(0, 1.05)) for k in range(100)
    ]
    assert [text for text in wrong if text] == []


@pytest.mark.slow
@pytest.mark.skipif(not killed_commands.can_mount(), reason="takes root, for a disk of its own")
def test_on_a_hundred_full_disks(all_scenes, tmp_path):
    (tmp_path / "disk").mkdir()
    dice, wrong = random.Random(2), []
    for _ in range(100):
        scene = dice.choice(all_scenes)
        most = sum(map(len, scene.new.values())) - sum(
            len(scene.new[n]) for n in scene.new if scene.old.get(n) == scene.new[n]
        )
        wrong.append(killed_commands.starved(scene, tmp_path / "disk", dice.randrange(int(1.5 * most) + 8192)))
    assert [text for text in wrong if text] == []
