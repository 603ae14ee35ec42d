"""Physics <-> the part of a calibration.json that holds it."""

from dataclasses import asdict
from typing import Any

import numpy as np

from calib.correct.physics import Physics, Unknown
from rig.effects.catalogue.effect_list import BY_NAME
from rig.effects.framework.fit_coordinates import coordinates_of
from rig.effects.texts.effect_text import Kinds, effect_from_dict, effect_to_dict, require_place
from rig.errors import FileError, RigError
from rig.formats.checked_entries import Entries
from rig.model.design import Actuator, Arm, Chain, Platform
from rig.model.mechanism_kinds import Struts


def physics_dict(physics: Physics) -> dict[str, Any]:
    """dict of Physics, as JSON holds it."""
    platform = {
        name: value.tolist() if isinstance(value, np.ndarray) else value
        for name, value in ((name, getattr(physics.platform, name)) for name in Platform.__slots__)
    }
    return {
        "effects": [effect_to_dict(effect) for effect in physics.effects],
        "parameter_order": [_told(c.effect, c.name, c.index, c.role, physics) for c in physics.coordinates],
        "covariance": physics.own.tolist(),
        "cross_covariance": physics.cross.tolist(),
        "gravity": physics.gravity.tolist(),
        "actuator": asdict(physics.actuator),
        "platform": platform,
        "channels": {name: {"median": value, "sigma": sigma} for name, (value, sigma) in physics.channels.items()},
        "unknown": [asdict(u) for u in physics.unknown],
    }


def _told(effect: int, name: str, index: int | None, role: str, physics: Physics) -> str:
    """A coordinate in words, for who reads the file."""
    measure = {"inverse": "1 / ", "log": "log of "}.get(role, "")
    at = physics.effects[effect]
    return f"{measure}{name}{'' if index is None else f' {index + 1}'} of {at.name} at {at.place}"


def physics_from_entries(
    table: Entries, mechanism: Struts | Arm | Chain, count: int, kinds: Kinds = BY_NAME
) -> Physics:
    """Physics of what `physics_dict` gave, as Entries. mechanism : nominal; count : of the geometry's parameters
    kinds : effects that there are. Raises FileError."""
    actuator, platform = table.table("actuator"), table.table("platform")
    held = Physics(
        (),
        np.zeros((0, 0)),
        np.zeros((count, 0)),
        table.array("gravity", (3,)),
        Actuator(
            actuator.number("screw_lead", None, above=0),
            actuator.text("joints", ("cardan-cardan", "cardan-ball"), None),
            actuator.number("max_speed", None, above=0),
        ),
        Platform(
            platform.number("mass", None, least=0),
            platform.array("centre_of_mass", (3,), None),
            platform.array("payload_centre_of_mass", (3,), None),
        ),
        {},
    )
    effects = []
    for entry in table.tables("effects"):
        try:
            effects.append(
                require_place(effect_from_dict(entry.tree, kinds), held.machine(mechanism))
                if not _seen(entry)
                else effect_from_dict(entry.tree, kinds)
            )
        except FileError:
            raise
        except RigError as error:
            table.fail(f"physics: {error}", "effects")
    own = len(coordinates_of(tuple(effects)))
    covariance, cross = table.array("covariance", (own, own)), table.array("cross_covariance", (count, own))
    if (np.diag(covariance) < 0).any() or not np.allclose(covariance, covariance.T, rtol=1e-6, atol=1e-300):
        table.fail("physics.covariance is no covariance", "covariance")
    channels = table.table("channels")
    logged = {
        name: (channels.table(name).number("median"), channels.table(name).number("sigma", least=0))
        for name in channels.tree
    }
    unknown = tuple(
        Unknown(u.text("place"), u.number("magnitude"), u.text("unit"), u.texts("depends_on"), u.flag("corrected"))
        for u in table.tables("unknown")
    )
    return Physics(tuple(effects), covariance, cross, held.gravity, held.actuator, held.platform, logged, unknown)


def _seen(entry: Entries) -> bool:
    """Whether an effect sits at what only cameras know of: a calibration holds no cameras to look it up in."""
    return str(entry.get("place", "")).partition(" ")[0] in ("camera", "cameras", "marker", "markers", "target")
