"""Images of a recording: one seed, one picture, by any number of processes; a disk that takes no more is an error."""

import resource

import numpy as np
import pytest

from rig.errors import FileError
from rig.planning import recording_plan as plan
from synthetic import image_simulation, random_true_machine_and_truth_file, recording_simulation


@pytest.fixture(scope="module")
def seen(opengl, design):
    """A simulation of two frames with three small cameras."""
    from dataclasses import replace

    small = replace(
        design,
        cameras=tuple(
            replace(c, width=320, height=256, matrix=c.matrix * [[0.25], [0.25], [1]]) for c in design.cameras
        ),
    )
    rng = np.random.default_rng(4)
    return recording_simulation.simulate_world(
        random_true_machine_and_truth_file.random_true_machine(small, rng), plan.build_plan(small, "sobol:2", 1), rng
    )


def drawn(folder, seen, processes):
    sensor = seen.world.true.sensor
    image_simulation.render_images(seen, folder, image_simulation.Images(sensor, processes=processes), 11)
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*.png")}


@pytest.mark.slow
def test_one_seed_draws_the_same_bytes_by_any_number_of_processes(seen, tmp_path):
    one, two = drawn(tmp_path / "1", seen, 1), drawn(tmp_path / "2", seen, 2)
    assert len(one) == 6 and one == two


@pytest.mark.slow
@pytest.mark.parametrize("processes", [1, 2])
def test_an_image_that_cannot_be_written_is_an_error(processes, seen, tmp_path, monkeypatch):
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (10_000, hard))
    try:
        with pytest.raises(FileError, match=r"cam\d/0000\d.png: cannot be written: File too large"):
            drawn(tmp_path, seen, processes)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert not list(tmp_path.rglob("*.part"))
