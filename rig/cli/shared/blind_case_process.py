"""Blind case in a process of its own.

A case of a campaign: drawn, or handed to a command that cannot read its truth.

Run as `python -m`: PARENT draw OUT INDEX SETTINGS, or PARENT command TRUTH and the command's own words. It does not
outlive the process PARENT.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING

from rig.array_and_json_types import Json
from rig.compute.worker_processes import end_when_parent_ends

if TYPE_CHECKING:
    from rig.array_and_json_types import Floats


WATCHED = (
    "open",
    "os.listdir",
    "os.scandir",
    "os.rename",
    "os.link",
    "os.symlink",
    "shutil.copyfile",
)  # events whose first argument is a path


def forbid_this_process_to_read_folder(folder: str | Path) -> None:
    """Forbid this process to read a folder.

    PermissionError from now on (PEP 578; irrevocable).
    """
    closed = os.path.realpath(folder)

    def watch(event: str, given: tuple[object, ...]) -> None:
        if event in WATCHED and given and isinstance(given[0], (str, bytes, os.PathLike)):
            path = os.path.realpath(os.fsdecode(given[0]))
            if path == closed or path.startswith(closed + os.sep):
                raise PermissionError(f"{path} is withheld from this process")

    sys.addaudithook(watch)


def draw_blind_case(campaign_folder: Path, index: int, settings: Json) -> None:
    """Draw a blind case and write it.

    Its recording, its truth and the hash of the truth.
    The hash comes last: from then on the case is blinded.
    """
    from rig.formats.output_files import CommandOutputs, write_text
    from synthetic.blind_campaign import truth_hash_path

    campaign_folder = Path(campaign_folder)
    folder, truth = campaign_folder / "recordings" / f"{index:04d}", campaign_folder / "truth" / f"{index:04d}.json"
    drawn = _drawn_arm_case if settings.get("mechanism") == "arm" else _drawn_case
    with CommandOutputs("blind", force=True) as outputs:
        write_truth, strengths = drawn(index, settings, outputs.folder(folder))
    write_truth(truth, index=index, settings=settings, strengths=strengths.tolist())
    write_text(
        truth_hash_path(campaign_folder, index), f"{sha256(truth.read_bytes()).hexdigest()}  ../truth/{truth.name}\n"
    )


def _drawn_case(index: int, settings: Json, folder: Path) -> tuple[Callable[..., None], Floats]:
    """(what writes the truth of a hexapod's case, its effects' strengths), its recording written."""
    from calib.diagnosis.effect_signal_to_noise_and_distinguishability_by_plan import platform_effect_signal_to_noise
    from rig.recording import recording_folder
    from synthetic import random_blind_platform_cases_with_truth as blind

    case = blind.draw_case(
        settings["seed"],
        index,
        settings["frames"],
        settings["withhold"],
        settings["hide"],
        settings["effects"],
        settings.get("images", False),
    )
    blind.write_recording(case, folder)
    world, written = case.simulation.world, recording_folder.load_recording(folder)
    written = written if case.image_settings is None else replace(written, corners=blind.simulated_corners(case))
    values = platform_effect_signal_to_noise(written, world.true, case.noise, world.effects, case.simulation.sensors)[
        : len(case.hidden)
    ]
    return partial(blind.write_truth, case), values


def _drawn_arm_case(index: int, settings: Json, folder: Path) -> tuple[Callable[..., None], Floats]:
    """The same of an arm's case."""
    from calib.diagnosis.effect_signal_to_noise_and_distinguishability_by_plan import arm_effect_signal_to_noise
    from synthetic import random_blind_arm_cases_with_truth as blind_arm

    case = blind_arm.draw_arm_case(settings["seed"], index, settings["frames"], settings["hide"], settings["effects"])
    blind_arm.write_recording(case, folder)
    done = case.simulation
    seen = case.sigma[: 1 if "positions" in case.hard else 2]
    return partial(blind_arm.write_truth, case), arm_effect_signal_to_noise(
        done.world.true, done.plan.commands, done.plan.t, seen, done.world.effects, done.sensors
    )


def run_command_without_folder_access(folder: str, command_words: Sequence[str]) -> int:
    """Run a command of `rig` without access to a folder.

    Returns its exit status
    """
    from rig.cli.command_line import main

    forbid_this_process_to_read_folder(folder)
    return main(list(command_words))


def main(command_words: Sequence[str]) -> int:
    """Run a blind case process by its command words.

    It draws a blind case, or runs a command without access to its truth; see the module.

    Returns the exit status
    """
    end_when_parent_ends(int(command_words[0]))
    if command_words[1] == "command":
        return run_command_without_folder_access(command_words[2], command_words[3:])
    draw_blind_case(Path(command_words[2]), int(command_words[3]), json.loads(command_words[4]))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
