"""How soon after its exposure a frame's pose and residuals are on the page: three cameras of 1280 x 1024, everything
that a run does.
"""

import json
import tempfile
import threading
import time
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import numpy as np

from calib.online.live_learner_limb_watch_run_state_and_display import Learner
from calib.online.observer_of_run_frames import RunObserver, RunStop
from calib.online.run_options_cameras_sensors_and_observer import compile_kernels_for_run
from calib.online.web_page_of_ongoing_run import RunPage
from rig.driving.cameras.camera_interface_clock_offset_exposure_and_user_cameras import Frame, SynchronisedCameras
from rig.driving.driver_opening_and_settling import parse_settling
from rig.driving.driving_clock import SystemClock
from rig.driving.move_and_record_loop import RunEquipment, RunOperator
from rig.driving.run_journal import Began, Journal
from rig.driving.run_steps_from_plan_and_progress_from_journal import steps_of_plan
from rig.formats.rig_toml import design_from_rig_toml
from rig.model.design import Sensor
from rig.planning.layout import hexapod_layout_and_camera_placement
from rig.planning.recording_plan import build_plan
from rig.recording import recording_folder
from synthetic import random_true_machine_and_truth_file, recording_simulation
from synthetic.image_simulation import Images
from vision.reading.corner_reading_from_recording_images import read_grey_or_colour_image
from vision.reading.live_measurement_and_corner_refit import TAUGHT, Live
from vision.reading.parallel_image_map_rendered_markers_and_white_level import save_image

FRAMES = 20
TIME = 1.0  # s that moving and settling take here, so that frames do not wait for each other


class _Source:
    """A camera that has its images already. waiting : of them, in order; taken : {number of the frame: s when it was
    handed over}
    """

    can_set_exposure = False

    def __init__(self, name, waiting, clock, times):
        self.name, self._waiting, self._clock, self._times = name, iter(waiting), clock, times

    def grab(self) -> Frame:
        image = next(self._waiting)
        now = self._clock.now()
        self._times[self.name].append(now)
        return Frame(image, now, 1e-4)

    def close(self) -> None:
        pass


def rows() -> Iterator[tuple[str, str, str]]:
    """(figure, reached, wanted)"""
    with tempfile.TemporaryDirectory() as folder:
        delays = _run(Path(folder))
    known = [delay for frame, delay in delays.items() if frame >= TAUGHT[0] and frame not in TAUGHT]
    for figure, frames in (
        ("cameras adjusted", known),
        ("images searched whole", [delays[frame] for frame in range(TAUGHT[0])]),
        ("after an adjustment of the cameras", [delay for frame, delay in delays.items() if frame in TAUGHT]),
    ):
        yield (
            f"from exposure to pose and residuals on the page, {figure}: median, most",
            f"{np.median(frames):.3f} s, {max(frames):.3f} s",
            "<= 0.5 s",
        )


def _run(folder):
    """{frame: s from its exposure to its event at the page}"""
    text = hexapod_layout_and_camera_placement.hexapod_layout_rig_toml(0.3, cameras=3, width=1280, height=1024)
    (folder / "rig.toml").write_text(text)
    design, rng, plan = (
        design_from_rig_toml.load_design(folder / "rig.toml"),
        np.random.default_rng(1),
        f"sobol:{FRAMES}",
    )
    done = recording_simulation.simulate_world(
        random_true_machine_and_truth_file.random_true_machine(design, rng), build_plan(design, plan), rng
    )
    recording_simulation.write_recording(
        done, folder / "drawn", text, rng, images=Images(Sensor(blur=0.5, read_noise=1.0))
    )
    read, clock = recording_folder.load_recording(folder / "drawn"), SystemClock()
    e, times = read.exposures, {camera.name: [] for camera in design.cameras}
    images = {
        c.name: [read_grey_or_colour_image(read.folder / n) for n, name in zip(e.image, e.camera) if name == c.name]
        for c in design.cameras
    }
    compile_kernels_for_run(design)  # as while homing
    shutter = SynchronisedCameras(tuple(_Source(name, own, clock, times) for name, own in images.items()), clock)
    planned = steps_of_plan(build_plan(design, plan))
    start = planned[0].goal
    machine = SimpleNamespace(lengths=lambda: start, move=lambda goal, permit: None, stop=lambda: None)
    bench = RunEquipment(machine, shutter, clock, parse_settling(f"time:{TIME}"), 1e-5, lambda *_: (), save_image)
    looking = RunObserver(
        design, planned, start, clock, Live(design), Learner(design.mechanism), RunStop(frozenset(), lambda: None)
    )
    (folder / "rec").mkdir()
    with RunPage(looking, 0) as page, Journal(folder / "rec" / "journal.jsonl") as journal:
        looking.displays.append(page)
        came = {}
        reader = threading.Thread(target=_listen, args=(page.url, came), daemon=True)
        reader.start()
        time.sleep(0.5)
        journal.append(Began(0.0, clock.now(), len(planned), "", tuple(start.tolist())))
        RunOperator(bench, planned, journal, design.mechanism.axes, journal.rows[0].wall, looking).run()
        looking.finish()
        time.sleep(0.5)
    shutter.close()
    epoch = clock.now() - time.monotonic()
    return {frame: t + epoch - max(own[frame] for own in times.values()) for frame, t in came.items()}


def _listen(url, came):
    """Note when each frame's figures came to a browser. came : {frame: s, monotonic}, added to"""
    with urllib.request.urlopen(url.replace("/?", "/events?")) as stream:
        for line in stream:
            if line.startswith(b"data: "):
                seen = json.loads(line[6:]).get("seen")
                if seen is not None:
                    came.setdefault(seen["frame"], time.monotonic())


if __name__ == "__main__":
    print(*rows(), sep="\n")
