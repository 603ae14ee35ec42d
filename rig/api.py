"""Python entry points of rig.

A recording loaded and saved, configurations planned, mistakes that its files show.
"""

import tempfile
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from rig.array_and_json_types import Floats, Json
from rig.checks.mistake_dataclass_and_clock_mistakes import Mistake, sort_mistakes
from rig.errors import FileError, RigError
from rig.formats.local_and_remote_input_files import read_bytes
from rig.formats.output_files import CommandOutputs, write_bytes
from rig.model import mechanisms
from rig.model.design import Design
from rig.model.pose import pose_difference
from rig.recording import recording_folder
from rig.recording.recording_folder import Recording
from rig.report.verdict_refutations_and_result_display import OneLineRepr, result_html

if TYPE_CHECKING:
    from rig.effects.framework.effect_base_class import Effect
    from rig.effects.sketches import Sketch
    from rig.formats.importers import ImportedRecording, Recipe

CERTAIN = 0.7  # proof of a mistake in the files, from which nothing is learnt by looking farther


def load(path: Path | str, skip_unreadable: bool = False, mask: str | None = None) -> Recording:
    """Load the Recording of a folder.

    It is checked.
    skip_unreadable : whether images that cannot be used are left out (see Recording.skipped), not refused
    mask : frames to leave out, as "3,7-9"
    Raises FileError that names file, line and column; RigError that names the likeliest mistake first, where the files
        show which it is

    >>> import rig
    >>> len(rig.load("tests/data/bench/check", mask="0-1").exposures.times()[0])
    4
    """
    from rig.checks.mistakes_that_make_recording_unreadable import unreadable_recording_mistakes
    from rig.recording.frame_selection_and_content_hashes import remove_frames

    path = Path(path)
    try:
        found = recording_folder.load_recording(path, skip_unreadable)
    except FileError as error:
        causes = unreadable_recording_mistakes(path, error)
        if not causes:
            raise
        raise RigError("\n".join([*map(str, causes), str(error)])) from None
    return found if mask is None else remove_frames(found, mask)


def save(recording: Recording, folder: Path | str, overwrite: bool = False) -> None:
    """Write a recording to a folder.

    Its rig.toml and tables, and the images of its frames.
    overwrite : whether to write over what this function did not make
    Raises RigError for several recordings joined to one, and where the folder holds something else
    """
    from rig.formats.rig_toml.mechanism_entries import write_kinematics_file
    from rig.recording.corner_and_pose_csv_tables import write_corners, write_poses, write_table
    from rig.recording.recording_folder import copy_frames_commands_and_sensors

    if recording.parts:
        raise RigError(f"{recording.name}: several recordings as one have no folder; save each separately")
    with CommandOutputs("save", (str(recording.folder),), [recording.folder], overwrite) as outputs:
        out = outputs.folder(Path(folder))
        write_bytes(out / "rig.toml", read_bytes(recording.folder / "rig.toml"))
        write_kinematics_file(out, recording.design.mechanism)
        copy_frames_commands_and_sensors(recording.folder, out, recording.exposures, recording.origin)
        exposed = recording.exposures
        rows = [
            f"{frame},{recording.origin.text(t)},{camera},{image}"
            for frame, t, camera, image in zip(exposed.frame, exposed.t, exposed.camera, exposed.image)
        ]
        write_table(out / "frames.csv", ("frame", "t", "camera", "image"), rows)
        for image in filter(None, exposed.image):
            (out / image).parent.mkdir(parents=True, exist_ok=True)
            write_bytes(out / image, read_bytes(recording.folder / image))
        if recording.corners is not None:
            write_corners(out / "corners.csv", recording.corners)
        for name, poses in {
            "poses.csv": recording.poses,
            **{f"poses_stage{number}.csv": stage for number, stage in recording.stages.items()},
        }.items():
            if poses is not None:
                write_poses(out / name, poses)


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class PlannedConfigurations(OneLineRepr):
    """Configurations that the parts of a plan visit. design; parts : their text; values : (n, axes) m or rad, in the
    order of visits; span : (2, 6) m and rad, least and greatest of the platform's move from home, None but of a hexapod
    """

    design: Design
    parts: str
    values: Floats
    span: Floats | None

    def __str__(self) -> str:
        return f"{len(self.values)} configurations of {self.parts}"

    def lines(self) -> list[str]:
        """How many there are and how far they go, in mm and mrad."""
        if self.span is None:
            return [str(self)]
        names = zip(("x", "y", "z", "rx", "ry", "rz"), ("mm",) * 3 + ("mrad",) * 3, *(self.span * 1e3))
        moves = ", ".join(f"{name} {low:+.1f} .. {high:+.1f} {unit}" for name, unit, low, high in names)
        return [str(self), f"from home, in the platform's axes: {moves}"]

    def _repr_html_(self) -> str:
        """As a notebook shows it."""
        first, *rest = self.lines()
        return result_html(first, rest)


def plan(design: Design, parts: str = "standard", seed: int = 0) -> PlannedConfigurations:
    """Planned configurations (PlannedConfigurations) of a design, from the parts of a plan.

    They are those at whose exposures the axes stand.

    parts : as of rig.planning.recording_plan.build_plan, for example "axes:5,combined:4"
    Raises RigError for a part that is not known, and for exposures on the way

    >>> import rig
    >>> design = rig.load_design("tests/data/bench/check/rig.toml")
    >>> print(rig.plan(design, "sobol:3"))
    3 configurations of sobol:3
    """
    from rig.driving.run_steps_from_plan_and_progress_from_journal import steps_of_plan
    from rig.planning.recording_plan import build_plan

    mechanism = design.mechanism
    goals = np.array([step.goal for step in steps_of_plan(build_plan(design, parts, seed)) for _ in range(step.frames)])
    span = None
    if mechanism.home_pose is not None:
        moved = pose_difference(mechanism.home_pose, mechanisms.kinematics_of(mechanism).forward(goals, mechanism))
        span = np.array([moved.min(axis=0), moved.max(axis=0)])
    return PlannedConfigurations(design, parts, goals, span)


@dataclass(frozen=True, slots=True, repr=False)
class CheckResult(OneLineRepr):
    """What is wrong or unlikely with a recording. found : most likely cause first; remarks : what could be better"""

    found: tuple[Mistake, ...]
    remarks: tuple[str, ...] = ()

    @property
    def usable(self) -> bool:
        """Whether results of the recording would mean something."""
        return not any(one.spoils for one in self.found)

    def lines(self) -> list[str]:
        """What was found, a line each."""
        lines = [f"{'wrong' if one.spoils else 'to look at'}: {one}" for one in self.found]
        return [*(lines or ["nothing wrong or unlikely was found"]), *(f"remark: {text}" for text in self.remarks)]

    def tree(self) -> Json:
        """What `rig check --json` prints."""
        return {
            "schema": "check/1",
            "usable": self.usable,
            "found": [asdict(one) for one in self.found],
            "remarks": list(self.remarks),
        }

    def __str__(self) -> str:
        wrong = sum(one.spoils for one in self.found)
        if wrong:
            return f"bad: {wrong} mistake{'s' * (wrong > 1)} that make{'s' * (wrong == 1)} results meaningless"
        return f"check: {len(self.found)} to look at" if self.found else "good: nothing wrong or unlikely was found"

    def _repr_html_(self) -> str:
        """As a notebook shows it."""
        return result_html(str(self), self.lines())


def check(path: Path | str) -> CheckResult:
    """Check of a recording's files, as a CheckResult.

    `calib.check` looks at corners, images and poses as well.

    >>> import rig
    >>> rig.check("tests/data/bench/check").usable
    True
    """
    return load_and_check_recording_files(Path(path))[1]


def load_and_check_recording_files(path: Path) -> tuple[Recording | None, CheckResult]:
    """Load a recording and check its files.

    Recording is None where the files show that no more can be learnt.

    Returns (Recording, CheckResult)
    """
    from rig.checks.design_value_camera_and_image_mistakes_and_all_file_checks import (
        mistakes_found_without_looking_at_images,
    )
    from rig.checks.mistakes_that_make_recording_unreadable import unreadable_recording_mistakes

    try:
        recording = recording_folder.load_recording(path)
    except FileError as error:
        first = Mistake(str(error), "Correct this first: nothing else could be checked")
        return None, CheckResult((*unreadable_recording_mistakes(path, error), first))
    found = mistakes_found_without_looking_at_images(recording)
    if any(one.spoils and one.proof >= CERTAIN for one in found):
        rest = Mistake("corners and poses were not checked", "Correct this first and repeat the check", False, 0.0)
        return None, CheckResult(sort_mistakes([*found, rest]))
    return recording, CheckResult(found)


@dataclass(frozen=True, slots=True)
class EffectCatalogue:
    """The catalogue of effects as a document. markdown : its text; sketches : {effect's name: SVG text}"""

    markdown: str
    sketches: dict[str, str]


def effect_catalogue(
    effects: "Mapping[str, type[Effect]]", folder: str = "", draw: "Callable[[type[Effect]], Sketch] | None" = None
) -> EffectCatalogue:
    """Catalogue (EffectCatalogue) of effects {name: class}.

    With a sketch of each where `draw` draws them.

    folder : where the document finds the sketches, NAME.svg; draw : raises RigError for an effect without a sketch
    """
    from rig.effects.catalogue.effect_list import catalogue_markdown
    from rig.report.pages.page_templates_and_index_page import standalone_svg

    drawn: dict[str, str] = {}
    shown: dict[str, str] = {}
    for name, kind in effects.items():
        if draw is None:
            break
        try:
            sketch = draw(kind)
        except RigError as error:
            shown[name] = f"No sketch: {error}."
            continue
        drawn[name] = standalone_svg(f"what {kind.label()} does", sketch.words, sketch.figures)
        shown[name] = f"![What {kind.label()} does: {sketch.words}]({folder}/{name}.svg)"
    return EffectCatalogue(catalogue_markdown(effects.values(), shown), drawn)


class ImportResult(NamedTuple):
    """A recording imported from foreign files. recording; remarks : what its files show of mistakes"""

    recording: "ImportedRecording"
    remarks: list[Mistake]


def import_recording(
    recipe: "Recipe", folder: Path, name: Path | None = None, skip_unreadable: bool = False
) -> ImportResult:
    """Import the recording that a recipe describes into a folder.

    The folder is empty.
    name : of the folder in errors, by default its path; skip_unreadable : whether unusable images are left out
    Returns what it holds and remarks on it
    Raises RigError for files that cannot be used, and for what is no recording once it is imported
    """
    from rig.checks.design_value_camera_and_image_mistakes_and_all_file_checks import (
        mistakes_found_without_looking_at_images,
    )
    from rig.formats import importers

    with tempfile.TemporaryDirectory(prefix="rig-bag-") as unpacked:
        imported = importers.assemble_recording(importers.unpack_recipe_bags(recipe, Path(unpacked)), skip_unreadable)
        importers.write_recording(imported, folder)
    try:
        recording = recording_folder.load_recording(folder)
    except RigError as error:
        text = str(error).replace(str(folder), str(name or folder))
        raise RigError(f"what was imported is not a recording: {text}") from None
    return ImportResult(imported, list(mistakes_found_without_looking_at_images(recording)))
