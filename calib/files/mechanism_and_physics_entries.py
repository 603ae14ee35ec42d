"""Mechanism and physics entries of calibration.json.

Written, read and checked.

Pose space maps included.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from calib.correction.physical_effects_of_calibration_and_their_compensation import Physics, Unknown
from rig.array_and_json_types import Booleans, Json
from rig.effects.catalogue.effect_list import BY_NAME
from rig.effects.framework.effect_checks_and_fit_coordinates import fit_coordinates_of_effects
from rig.effects.framework.unmodelled_curve_and_formula_quantities import curve_classes_by_covariate
from rig.effects.texts.effect_text_parsing_and_user_effect_file_loading import Kinds
from rig.formats.checked_toml_and_json_entries import LARGEST_RIG, Entries
from rig.formats.json_toml_and_yaml_loading import json_data
from rig.formats.local_and_remote_input_files import short_repr
from rig.formats.machine_geometry_and_effects_json_file import effect_to_dict, effects_from_entries
from rig.formats.rig_toml.design_from_rig_toml import base_tilt_of_table
from rig.formats.rig_toml.hexapod_and_two_strut_entries import follower_strut_numbers, stated_strut_count
from rig.formats.rig_toml.mechanism_entries import (
    branches_of_tables,
    couplings_of_tables,
    hands_of_tables,
    json_of_branches_hands_and_couplings,
    mechanism_of_kinematics_file,
)
from rig.model import mechanisms
from rig.model.arm_hands_effect_places_and_tolerances import Place
from rig.model.design import Actuator, Platform
from rig.model.mechanism_geometry_classes import Arm, Chain, FileMechanism, Hexapod, Planar2
from rig.model.mechanisms.mechanism_kinds_and_kinematics import (
    Commanded,
    Parallel,
    Struts,
    has_links,
    has_stages,
    has_struts,
    is_hexapod,
)


def require_known_text(tree: Entries, key: str, known_texts: Sequence[str]) -> None:
    """Raise FileError where a key's text is not one of those known.

    Units, frames and orders.
    """
    found = tree.text(key)
    if found not in known_texts:
        differs = next(
            (i for i, (a, b) in enumerate(zip(found, known_texts[0])) if a != b), min(len(found), len(known_texts[0]))
        )
        start = max(differs - 20, 0)
        tree.fail(
            f"{key} is {short_repr(found[start : differs + 40])} where this version expects "
            f"{short_repr(known_texts[0][start : differs + 40])} "
            f"(character {differs + 1}); nothing is converted",
            key,
            value=found,
        )


def require_schema_contents(tree: Entries, needed: Sequence[str], refused: Sequence[str]) -> None:
    """Raise FileError where a file's contents are not those of its schema.

    It lacks what its schema requires, or holds what only another has.
    """
    schema = tree.text("schema")
    for key in needed:
        if tree.get(key, None) is None:
            tree.fail(f"{key} is missing, and a file of schema {short_repr(schema)} has it", "schema")
    for key in refused:
        if key in tree.tree:
            tree.fail(
                f"{key} is there, and a file of schema {short_repr(schema)} has none: a reader of that "
                "schema would ignore it silently",
                key,
            )


def _require_plausible(table: Entries, mechanism: Parallel | Arm, stated: bool) -> None:
    """Raise FileError for ranges, zeros and joints that no machine has, lengths in m. stated : whether it is the
    owner's, whose home is in reach
    """
    if has_links(mechanism):
        _require_plausible_arm(table, mechanism)
    elif has_struts(mechanism):
        _require_plausible_struts(table, mechanism, stated)


def _require_plausible_struts(table: Entries, mechanism: Struts, stated: bool) -> None:
    for i, (low, high) in enumerate(mechanism.strut_range):
        if not 0 < low < high:
            table.fail(
                f"{table.name('strut_range')}[{i + 1}] must be positive and run from small to large, not "
                f"{low:g} .. {high:g} m",
                "strut_range",
                i,
                value=[low, high],
            )
        if abs(mechanism.strut_zeros[i]) > high:
            table.fail(
                f"{table.name('strut_zeros')}[{i + 1}] = {mechanism.strut_zeros[i]:g} m is more than the "
                f"strut's greatest length, {high:g} m",
                "strut_zeros",
                i,
                value=float(mechanism.strut_zeros[i]),
            )
    if stated and mechanism.home_pose is not None:
        lengths = mechanisms.kinematics_of(mechanism).home_values(mechanism)
        for i, (length, (low, high)) in enumerate(zip(lengths, mechanism.strut_range)):
            if not low <= length <= high:
                table.fail(
                    f"{table.name('home')} needs strut {i + 1} at {length:.6f} m, outside its strut_range "
                    f"{low:g} .. {high:g} m",
                    "home",
                )


def require_same_ranges(tree: Entries, nominal: Commanded, fitted: Commanded) -> None:
    """Raise FileError where nominal and fitted mechanism have different ranges.

    Where they differ in kind, or do not have the same axis ranges.
    """
    if (fitted.kind, len(fitted.axes)) != (nominal.kind, len(nominal.axes)):
        tree.fail(
            f"fitted is of kind {fitted.kind!r} with {len(fitted.axes)} axes, nominal of kind "
            f"{nominal.kind!r} with {len(nominal.axes)}",
            "fitted",
            "kind",
        )
    if has_struts(nominal) and has_struts(fitted):
        different = np.flatnonzero((nominal.strut_range != fitted.strut_range).any(axis=1))
        if len(different):
            i = int(different[0])
            tree.fail(
                f"fitted.strut_range[{i + 1}] is {fitted.strut_range[i].tolist()} m and nominal.strut_range[{i + 1}] "
                f"{nominal.strut_range[i].tolist()} m: they are the same strut's",
                "fitted",
                "strut_range",
                i,
            )


def _require_plausible_arm(table: Entries, arm: Arm) -> None:
    for i, (low, high) in enumerate(arm.limits):
        if not low < high:
            table.fail(
                f"{table.name('limits')}[{i + 1}] must run from small to large, not {low:g} .. {high:g} (m or rad)",
                "limits",
                i,
                value=[low, high],
            )
        if arm.slides[i]:
            for j in range(2):
                table.numbers(float(arm.limits[i, j]), (), "limits", (i, j), LARGEST_RIG)
    for i, j in np.argwhere(np.abs(arm.rows[:, 1:3]) > LARGEST_RIG):
        table.numbers(float(arm.rows[i, 1 + j]), (), "joints", (int(i), int(1 + j)), LARGEST_RIG)


MOST_JOINTS = 64


def mechanism_dict(mechanism: Commanded) -> Json:
    """dict of a mechanism, as JSON holds it."""
    if has_stages(mechanism):
        return {"kind": mechanism.kind, "stages": [mechanism_dict(stage) for stage in mechanism.stages]}
    if has_links(mechanism):
        ends = bool(mechanism.hands)  # of several hands each states its own tool
        return {
            "kind": mechanism.kind,
            "joints": mechanism.rows.tolist(),
            **{name: json_data(getattr(mechanism, name)) for name in ("limits", "base", "tool")[: 3 - ends]},
            **({"slides": mechanism.slides.tolist()} if mechanism.slides.any() else {}),
            **json_of_branches_hands_and_couplings(mechanism),
        }
    if not has_struts(mechanism):
        return kinematics_file_mechanism_dict(mechanism)
    followers = is_hexapod(mechanism) and mechanism.followers
    return {
        "kind": mechanism.kind,
        **{name: json_data(getattr(mechanism, name)) for name in SHAPES[mechanism.kind]},
        **({"followers": [one + 1 for one in followers]} if followers else {}),
    }


def mechanism_from_entries(table: Entries, is_nominal: bool = False) -> Commanded:
    """Mechanism from its JSON entries.

    is_nominal : whether it is the nominal one.
    Raises FileError for anything else.
    """
    if "file" in table.tree:
        return kinematics_file_mechanism_from_entries(table)
    if table.text("kind", (*READERS, CHAIN)) == CHAIN:
        stages = table.tables("stages")
        if len(stages) < 2:
            table.fail(f"{table.name('stages')} of a chain are two or more, got {len(stages)}", "stages")
        return Chain(tuple(_stage_in(stage, is_nominal) for stage in stages))
    return _stage_in(table, is_nominal)


def kinematics_file_mechanism_dict(mechanism: FileMechanism) -> Json:
    """dict of a mechanism of a kinematics file, as JSON holds it.

    The file by name and hash, and its parameters.
    """
    stated = mechanism.stated
    return {
        "kind": mechanism.kind,
        "file": Path(mechanism.file).name,
        "sha256": stated.sha256,
        "parameters": mechanism.parameters.tolist(),
        "parameter_names": list(stated.names),
    }


def kinematics_file_mechanism_from_entries(table: Entries) -> FileMechanism:
    """Mechanism of a kinematics file from its JSON entries.

    The file lies beside.
    Raises FileError for another file.
    """
    table.text("kind", (FileMechanism.kind,))
    nominal = mechanism_of_kinematics_file(table, "file", table.text("file"))
    if table.text("sha256") != nominal.stated.sha256:
        table.fail(
            f"{table.name('file')}: {nominal.file} is not the kinematics file that this was made with: its text has "
            "changed; make this file anew",
            "sha256",
        )
    return replace(nominal, parameters=table.array("parameters", nominal.parameters.shape, length_limit=LARGEST_RIG))


def _stage_in(table: Entries, stated: bool) -> Struts | Arm:
    """A mechanism that stands alone, or in a chain, of figures that a machine may have."""
    found = READERS[table.text("kind", tuple(READERS))](table)
    _require_plausible(table, found, stated)
    return found


def _struts(kind: type[Hexapod] | type[Planar2], table: Entries) -> Hexapod | Planar2:
    axes = stated_strut_count(table) if kind is Hexapod else SHAPES[kind.kind]["base_joints"][0]
    figures: Json = {
        name: table.pose(name) if shape == POSE else table.array(name, (axes, *shape[1:]), length_limit=LARGEST_RIG)
        for name, shape in SHAPES[kind.kind].items()
    }
    if "followers" in table.tree:
        figures["followers"] = follower_strut_numbers(table, axes)
    return kind(**figures)


def _arm(table: Entries) -> Arm:
    rows = table.get("joints")
    columns = len(rows[0]) if isinstance(rows, list) and rows and isinstance(rows[0], list) and len(rows[0]) == 4 else 5
    joints = table.array("joints", (None, columns))
    if not 0 < len(joints) <= MOST_JOINTS:
        table.fail(f"{table.name('joints')} has {len(joints)} rows; an arm has 1 to {MOST_JOINTS} joints", "joints")
    branches = branches_of_tables(table, len(joints))
    hands = hands_of_tables(table, len(joints), branches)
    slides = _slides_in(table, len(joints))
    return Arm(
        joints,
        table.array("limits", (len(joints), 2)),
        table.pose("base"),
        hands[0].tool if hands else table.pose("tool"),
        slides,
        branches,
        hands,
        couplings=couplings_of_tables(table, slides),
    )


def _slides_in(table: Entries, count: int) -> Booleans:
    """(count,) bool, which joints slide; none where nothing is said."""
    listed = table.get("slides", [False] * count)
    if not isinstance(listed, list) or len(listed) != count or not all(isinstance(slide, bool) for slide in listed):
        table.fail(f"{table.name('slides')} must list {count} times true or false", "slides")
    return np.array(listed, bool)


POSE = ()
SHAPES: dict[str, dict[str, tuple[int, ...]]] = {
    Hexapod.kind: {
        "base_joints": (6, 3),
        "platform_joints": (6, 3),
        "strut_range": (6, 2),
        "strut_zeros": (6,),
        "home": POSE,
    },
    Planar2.kind: {"base_joints": (2, 2), "strut_range": (2, 2), "strut_zeros": (2,)},
}  # {kind: {entry: its shape}}, in a file's order; a hexapod of more struts has more rows
READERS: dict[str, Callable[[Entries], Struts | Arm]] = {
    Hexapod.kind: partial(_struts, Hexapod),
    Planar2.kind: partial(_struts, Planar2),
    Arm.kind: _arm,
}
CHAIN = Chain.kind


def physics_dict(physics: Physics) -> Json:
    """dict of Physics, as JSON holds it."""
    return {
        "effects": [effect_to_dict(effect) for effect in physics.effects],
        "parameter_order": [_coordinate_text(c.effect, c.name, c.index, c.role, physics) for c in physics.coordinates],
        "covariance": physics.own.tolist(),
        "cross_covariance": physics.cross.tolist(),
        "gravity": physics.gravity.tolist(),
        "actuator": json_data(physics.actuator),
        "platform": json_data(physics.platform),
        "channels": {name: {"median": value, "sigma": sigma} for name, (value, sigma) in physics.channels.items()},
        "unknown": json_data(physics.unknown),
        **({"tilts": json_data(physics.tilts)} if physics.tilts else {}),
    }


def _coordinate_text(effect: int, name: str, index: int | None, role: str, physics: Physics) -> str:
    """A coordinate in words, for who reads the file."""
    measure = {"inverse": "1 / ", "log": "log of "}.get(role, "")
    at = physics.effects[effect]
    return f"{measure}{name}{'' if index is None else f' {index + 1}'} of {at.name} at {at.place}"


def physics_from_entries(table: Entries, mechanism: Commanded, parameter_count: int, kinds: Kinds = BY_NAME) -> Physics:
    """Physics from its entries in calibration.json, as `physics_dict` gives them.

    mechanism : nominal; parameter_count : of the geometry's parameters; kinds : effects that there are. Raises
    FileError.
    """
    actuator, platform = table.table("actuator"), table.table("platform")
    held = Physics(
        (),
        np.zeros((0, 0)),
        np.zeros((parameter_count, 0)),
        table.array("gravity", (3,)),
        Actuator(
            actuator.number("screw_lead", None, above=0),
            actuator.text("joints", ("cardan-cardan", "cardan-ball"), default=None),
            actuator.number("max_speed", None, above=0),
        ),
        Platform(
            platform.number("mass", None, least=0),
            platform.array("centre_of_mass", (3,), None),
            platform.array("payload_centre_of_mass", (3,), None),
        ),
        {},
    )
    channels = table.table("channels")
    logged = {
        name: (channels.table(name).number("median"), channels.table(name).number("sigma", least=0))
        for name in channels.tree
    }
    known = {**kinds, **curve_classes_by_covariate(tuple(logged))}
    effects = effects_from_entries(table, held.machine(mechanism), known, lambda entry: not _seen(entry))
    own = len(fit_coordinates_of_effects(effects))
    covariance, cross = table.array("covariance", (own, own)), table.array("cross_covariance", (parameter_count, own))
    if (np.diag(covariance) < 0).any() or not np.allclose(covariance, covariance.T, rtol=1e-6, atol=1e-300):
        table.fail("physics.covariance is not a covariance", "covariance")
    unknown = tuple(_unknown(entry) for entry in table.tables("unknown"))
    tilts = tuple(base_tilt_of_table(entry) for entry in table.tables("tilts"))
    return Physics(effects, covariance, cross, held.gravity, held.actuator, held.platform, logged, unknown, tilts)


def _unknown(entry: Entries) -> Unknown:
    """An Unknown from its entries; curves that undo some of it may be absent."""
    size, unit, names = entry.number("magnitude"), entry.text("unit"), entry.texts("depends_on")
    found = Unknown(entry.text("place"), size, unit, names, entry.flag("corrected"))
    if "by" not in entry.tree:
        return found
    before, after = entry.array("held_out", (2,)).tolist()
    size_unit = entry.text("held_out_unit", ("m", "rad"), "m")
    return replace(found, by=entry.texts("by"), held_out=(before, after), held_out_unit=size_unit)


def _seen(entry: Entries) -> bool:
    """Whether an effect sits at what only cameras know of: a calibration holds no cameras to look it up in."""
    return Place.parse(str(entry.get("place", ""))).kind in ("camera", "cameras", "marker", "markers", "target")
