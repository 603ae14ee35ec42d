"""Nominal arms that come with the program, to try things on: a rig.toml each in rig/arms, its source named there."""

from importlib.resources import files
from pathlib import Path

from rig.errors import RigError
from rig.formats.rig_toml import design_file
from rig.model.design import Design

INSTRUMENT = """
[instrument]            # a laser tracker with a probe of six degrees of freedom
base = "free"           # where it stands is unknown and solved for; "rig" where poses.csv is in the arm's own base
tool = "free"           # where its target sits on the hand, likewise
position_sigma = 2e-5   # m
rotation_sigma = 1e-4   # rad
"""


def shipped_arm_names() -> list[str]:
    """Names of the arms that are shipped, sorted."""
    return sorted(
        entry.name.removesuffix(".toml") for entry in (files("rig") / "arms").iterdir() if entry.name.endswith(".toml")
    )


def shipped_arm_path(text: str) -> Path:
    """The rig.toml that a path or a shipped arm's name means. Raises RigError for what is neither."""
    if Path(text).exists() or Path(text).suffix:
        return Path(text)
    if text not in shipped_arm_names():
        raise RigError(
            f"there is no file {text!r}, nor is it one of the shipped arms: {', '.join(shipped_arm_names())}"
        )
    return Path(str(files("rig") / "arms" / f"{text}.toml"))


def load_shipped_arm(text: str) -> Design:
    """Design of a rig.toml's path, or of a shipped arm's name. Raises RigError for what is neither, FileError as
    rig.formats.rig_toml.design_file.load."""
    return design_file.load(shipped_arm_path(text))


def shipped_arm_rig_toml(name: str) -> str:
    """Text of a rig.toml with a shipped arm that an instrument measures. Raises RigError for a name that there is
    not.
    """
    if name not in shipped_arm_names():
        raise RigError(f"there is no arm {name!r}; there are {', '.join(shipped_arm_names())}")
    return (files("rig") / "arms" / f"{name}.toml").read_text(encoding="utf-8") + INSTRUMENT
