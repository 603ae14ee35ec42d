"""Options of why, and import of its data.

WhyOptions states what is known of the data, which are read, or imported as a recording.
"""

from dataclasses import dataclass
from pathlib import Path

from rig.api import import_recording, load
from rig.errors import RigError
from rig.formats.importers.arm_of_urdf_or_dh_table import ArmFileOptions, read_arm_file
from rig.formats.importers.import_recipe_of_path import import_recipe_of_path, is_recording_folder
from rig.formats.json_toml_and_yaml_loading import toml_entries
from rig.formats.local_and_remote_input_files import list_folder, read_bytes, read_text
from rig.formats.output_files import write_bytes, write_text
from rig.formats.rig_toml.design_from_rig_toml import LARGEST, design_of_entries
from rig.recording.recording_folder import Recording
from vision.checks.recording_refusal_and_cube_layout_remarks import Notice

NOISE = (2e-5, 2e-4)  # m, rad; of a laser tracker and its six-degree-of-freedom probe, where nobody states any


@dataclass(frozen=True, slots=True)
class WhyOptions:
    """What is known beside the data. arm : file of the arm, a URDF or a table of rows; rig : a rig.toml, None for
    neither, where the data have their own

    position_sigma : m, rotation_sigma : rad, of the instrument that measured an arm's poses; None for NOISE, assumed
    settings : "KEY=VALUE" as of `rig import --set`; anyway : whether to go on though a mistake makes results
    meaningless
    Raises RigError for an arm and a rig.toml both
    """

    arm: ArmFileOptions = ArmFileOptions()
    rig: Path | None = None
    position_sigma: float | None = None
    rotation_sigma: float | None = None
    settings: tuple[str, ...] = ()
    anyway: bool = False

    def __post_init__(self) -> None:
        if self.arm.file is not None and self.rig is not None:
            raise RigError("--urdf or --dh and --rig both state the machine; give only one")
        for name in ("position_sigma", "rotation_sigma"):
            value = getattr(self, name)
            if value is not None and not 0 < value <= 1:
                raise RigError(f"--{name.replace('_', '-')} takes a size above 0 and up to 1, not {value:g}")
            if value is not None and self.arm.file is None:
                raise RigError(f"--{name.replace('_', '-')} belongs to --urdf or --dh; rig.toml has [instrument]")


def recording_of_data(data: Path, options: WhyOptions, folder: Path, notice: Notice) -> tuple[Recording, bool]:
    """Recording of data, and whether its poses' noise is assumed.

    It is loaded as it is, or imported to a folder.
    folder : gets a folder `recording`; notice : called with lines on what was read
    Raises as `why`
    """
    arm = read_arm_file(options.arm)
    is_recording = is_recording_folder(data)
    if arm is None and options.rig is None:
        if is_recording and "rig.toml" in list_folder(data):
            return load(data), False
        raise RigError(
            f"{data} does not state the machine: add --urdf FILE.urdf, --dh FILE.csv (Denavit-Hartenberg rows) or "
            "--rig rig.toml"
        )
    for line in () if arm is None else arm.lines:
        notice(line)
    if arm is None:
        assert options.rig is not None
        text = read_text(options.rig, LARGEST)
    else:
        text = arm.rig_toml() + _instrument_text(options, True)
    stated = folder / "rig.toml" if options.rig is None else options.rig
    design = design_of_entries(toml_entries(text, stated))
    into = folder / "recording"
    if is_recording:
        _copy_without_machine(data, into, notice)
        write_text(into / "rig.toml", text)
        return load(into), arm is not None and options.position_sigma is None
    if arm is not None:
        write_text(stated, text)
    recipe = import_recipe_of_path(data, stated, design, () if arm is None else arm.joint_names, options.settings)
    into.mkdir()
    imported, remarks = import_recording(recipe, into, data)
    if arm is not None:
        stated.unlink()
        posed = imported.posed
        if posed is not None and posed.alone:
            (into / "rig.toml").unlink()
            write_text(into / "rig.toml", arm.rig_toml() + _instrument_text(options, False))
    for line in (*imported.said, *map(str, remarks)):
        notice(line)
    return load(into), arm is not None and options.position_sigma is None


def _copy_without_machine(data: Path, folder: Path, notice: Notice) -> None:
    """Copy a recording's files, all but its rig.toml."""
    for path in sorted(path for path in data.rglob("*") if path.is_file()):
        if path == data / "rig.toml":
            notice(f"{path} is not read: the machine is stated otherwise")
            continue
        into = folder / path.relative_to(data)
        into.parent.mkdir(parents=True, exist_ok=True)
        write_bytes(into, read_bytes(path))


def _instrument_text(options: WhyOptions, turns: bool) -> str:
    """Text of [instrument]. turns : whether it measures rotations"""
    position, rotation = (
        default if value is None else value
        for value, default in zip((options.position_sigma, options.rotation_sigma), NOISE)
    )
    lines = ["[instrument]", 'base = "free"', 'tool = "free"', f"position_sigma = {position!r}   # m"]
    return "\n".join([*lines, *([f"rotation_sigma = {rotation!r}   # rad"] if turns else []), ""])
