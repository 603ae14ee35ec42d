"""Machine geometry and effects as a JSON file.

True or identified geometry, cameras, effects.
"""

from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform

from rig.array_and_json_types import Json
from rig.effects.catalogue.effect_list import BY_NAME
from rig.effects.framework.effect_base_class import Effect
from rig.effects.framework.effect_checks_and_fit_coordinates import effect_with_valid_place_and_parameters
from rig.effects.texts.effect_text_parsing_and_user_effect_file_loading import (
    Kinds,
    effect_class_by_name,
    effect_with_existing_place,
)
from rig.errors import FileError, RigError
from rig.formats import json_toml_and_yaml_loading
from rig.formats.checked_toml_and_json_entries import LARGEST_RIG, Entries
from rig.formats.local_and_remote_input_files import short_repr
from rig.model.arm_hands_effect_places_and_tolerances import hand_names
from rig.model.design import Camera, Design
from rig.model.mechanisms.mechanism_kinds_and_kinematics import Mechanism, has_stages, require_arm
from rig.model.pose import pose, pose_to_vector

LIMBS = ("base_joints", "platform_joints", "zeros")


def machine_dict(design: Design, effects: Iterable[Effect]) -> Json:
    """Dict of a machine for JSON.

    Effects, geometry by name, cameras, measuring limbs.
    """
    m = design.mechanism
    out = {"effects": [effect_to_dict(effect) for effect in effects], **_geometry(m)}
    out["cameras"] = [
        {
            **{
                name: json_toml_and_yaml_loading.json_data(getattr(c, name))
                for name in ("name", "matrix", "distortion")
            },
            "pose": pose_to_vector(c.pose).tolist(),
        }
        for c in design.cameras
    ]
    return out | (
        {"insitu": {name: getattr(design.insitu, name).tolist() for name in LIMBS}} if design.insitu is not None else {}
    )


def _geometry(m: Mechanism) -> Json:
    """Geometry by name; of a chain that of each stage."""
    if m.bodies:
        return {"stages": [_geometry(stage) for stage in m.stages]}
    return {
        **{name: array.tolist() for name, array in m.geometry_arrays.items()},
        **{name: pose_to_vector(getattr(m, name)).tolist() for name in m.placements},
        **({name: pose_to_vector(T).tolist() for name, T in _ends_of_several_hands(m)} if hand_names(m) else {}),
    }


def _ends_of_several_hands(m: Mechanism) -> list[tuple[str, RigidTransform]]:
    """[(name, pose)] of the mounts of an arm's branches and the tools of its hands."""
    arm = require_arm(m)
    mounts = [(f"mount_{branch.joint + 1}", branch.mount) for branch in arm.branches]
    return [*mounts, *((f"tool_{hand.name}", hand.tool) for hand in arm.hands)]


def effect_to_dict(effect: Effect) -> Json:
    """Dict of an effect.

    {"effect", "place", "parameters"}, as truth files and diagnoses write it.
    """
    return {
        "effect": effect.name,
        "place": effect.place,
        "parameters": {
            key: list(value) if isinstance(value, tuple) else value
            for key, value in effect.values().items()
            if isinstance(value, tuple) or np.isfinite(value)
        },
    }  # what is infinite is its default


def effect_from_dict(tree: Json, known_effects: Kinds = BY_NAME) -> Effect:
    """Effect of a known kind from a dict.

    As `effect_to_dict` writes it.
    Raises RigError for anything else.
    """
    if (
        not isinstance(tree, dict)
        or not isinstance(tree.get("effect"), str)
        or not isinstance(tree.get("place"), str)
        or not isinstance(tree.get("parameters"), dict)
    ):
        raise RigError(f"{short_repr(tree)} is not an effect: it requires effect, place and parameters")
    kind = effect_class_by_name(tree["effect"], tree["effect"], known_effects)
    own = {parameter.name for parameter in kind.parameters}
    values = {}
    for key, value in tree["parameters"].items():
        numbers = value if isinstance(value, list) else [value]
        if key not in own or not all(isinstance(v, int | float) and not isinstance(v, bool) for v in numbers):
            raise RigError(
                f"{short_repr(tree)} is no effect: {short_repr(key)} = {short_repr(value)}; {kind.name} has "
                f"{', '.join(sorted(own))}, numbers"
            )
        values[key] = tuple(value) if isinstance(value, list) else value
    try:
        return effect_with_valid_place_and_parameters(kind(tree["place"], **values))
    except (TypeError, ValueError, OverflowError) as error:
        raise RigError(f"{short_repr(tree)} is no effect: {error}") from None


def load_machine(
    path: Path, nominal_design: Design, effect_kinds: Kinds = BY_NAME
) -> tuple[Design, tuple[Effect, ...]]:
    """Load a machine.

    What the file lacks is nominal.
    effect_kinds : effects that there are

    Returns (its Design, its effects)
    Raises FileError for a file that is none of this rig
    """
    found, limbs = json_toml_and_yaml_loading.load_json(path, "truth of this rig"), nominal_design.insitu
    if "effects" not in found.tree:
        found.fail("is not a truth of this rig: effects are missing", "effects")
    mechanism = _mechanism(nominal_design.mechanism, found)
    known = {entry.text("name"): entry for entry in found.tables("cameras")}
    missing = [c.name for c in nominal_design.cameras if c.name not in known]
    if missing:
        found.fail(f"is not a truth of this rig: cameras lacks {missing[0]!r}", "cameras")
    cameras = tuple(_camera(c, known[c.name]) for c in nominal_design.cameras)
    if limbs is not None and "insitu" in found.tree:
        table = found.table("insitu")
        base, platform, zeros = (
            table.array(name, getattr(limbs, name).shape, length_limit=LARGEST_RIG) for name in LIMBS
        )
        limbs = replace(limbs, base_joints=base, platform_joints=platform, zeros=zeros)
    effects = effects_from_entries(found, nominal_design, effect_kinds)
    return replace(nominal_design, mechanism=mechanism, cameras=cameras, insitu=limbs), effects


def _mechanism(stated: Mechanism, table: Entries) -> Mechanism:
    """The mechanism of such a file, as far as it states it; the rest as stated."""
    if has_stages(stated):
        parts = table.tables("stages")
        if len(parts) != len(stated.stages):
            table.fail(f"{table.name('stages')} must hold {len(stated.stages)} stages, got {len(parts)}", "stages")
        stages = tuple(_mechanism(stage, part) for stage, part in zip(stated.stages, parts))
        return replace(stated, stages=stages)  # type: ignore[arg-type]
    found: dict[str, Any] = {}
    for name, array in stated.geometry_arrays.items():
        if name in table.tree:
            found[name] = table.array(name, array.shape, length_limit=LARGEST_RIG)
    for name in stated.placements:
        if name in table.tree:
            found[name] = pose(*np.split(table.array(name, (6,), length_limit=LARGEST_RIG), 2))
    if hand_names(stated):
        arm = require_arm(stated)
        ends = [
            pose(*np.split(table.array(name, (6,), length_limit=LARGEST_RIG), 2)) if name in table.tree else T
            for name, T in _ends_of_several_hands(stated)
        ]
        count = len(arm.branches)
        found["branches"] = tuple(replace(one, mount=T) for one, T in zip(arm.branches, ends[:count]))
        found["hands"] = tuple(replace(one, tool=T) for one, T in zip(arm.hands, ends[count:]))
    return replace(stated, **found)


def _camera(camera: Camera, table: Entries) -> Camera:
    """A Camera as such a file has it."""
    matrix, terms, vector_ = (
        table.array("matrix", (3, 3)),
        table.array("distortion", (len(camera.distortion),)),
        table.array("pose", (6,)),
    )
    if (np.diag(matrix)[:2] <= 0).any() or (matrix[[0, 1, 2, 2, 2], [1, 0, 0, 1, 2]] != [0, 0, 0, 0, 1]).any():
        table.fail(f"{table.name('matrix')} is not a camera matrix: {matrix.tolist()}", "matrix")
    return replace(camera, matrix=matrix, distortion=terms, pose=pose(vector_[:3], vector_[3:]))


def effects_from_entries(
    table: Entries, design: Design, kinds: Kinds, has_place: Callable[[Entries], bool] = lambda entry: True
) -> tuple[Effect, ...]:
    """Effects from the entries "effects" of a table.

    has_place : whether an entry's place is looked up in the design
    Raises FileError for an unknown one, or one whose place a design has not.
    """
    found = []
    for number, entry in enumerate(table.tables("effects"), 1):
        try:
            effect = effect_from_dict(entry.tree, kinds)
            found.append(effect_with_existing_place(effect, design) if has_place(entry) else effect)
        except FileError:
            raise
        except RigError as error:
            table.fail(f"{table.name('effects')}.{number}: {error}", "effects")
    return tuple(found)
