"""The directions in which the continuous parameters of admitted effects move corners and closures."""

import numpy as np

from calib.diagnosis.engine.linear_model import Column, join_columns
from calib.diagnosis.problems.platform.effect_candidates import affects_images_only
from calib.diagnosis.problems.platform.effect_sensitivities import Sensitivities
from calib.diagnosis.problems.platform.linearised_residuals import LinearisedModel
from rig.arrays import Floats, Integers
from rig.effects.framework.diagnosis_interface import COUNT, Linear
from rig.effects.framework.effect import Effect
from rig.effects.framework.fit_coordinates import Coordinate, coordinates_of_effects


def parameter_directions(
    model: LinearisedModel, sensitivities: Sensitivities
) -> tuple[list[Coordinate], Column | None]:
    """(coordinates, Column of directions) of the continuous parameters of the admitted effects."""
    k, parts = model.point, []
    sensitivities, coordinates = sensitivities.at(k), coordinates_of_effects(k.effects)
    for number, effect in enumerate(k.effects):
        own = [c for c in coordinates if c.effect == number]
        if (
            affects_images_only(effect)
            and type(effect).mount is Effect.mount
            and own
            and all(c.role == "linear" for c in own)
        ):
            pixels = [sensitivities.corners(*_still(effect, c, sensitivities)) for c in own]
            parts.append(model.fold(np.concatenate(pixels, axis=2)))
            continue
        for c in own:
            ends = c.around(effect)
            both = [k.effects[:number] + (c.written(effect, end),) + k.effects[number + 1 :] for end in ends]
            apart = ends[0] - ends[1]
            if affects_images_only(effect):
                parts.append(model.fold(((k.pixels(both[0]) - k.pixels(both[1])) / apart)[..., None]))
            else:
                parts.append(model.lengthened(((k.effective(both[0]) - k.effective(both[1])) / apart)[..., None]))
    return coordinates, join_columns(parts) if parts else None


def _still(effect: Effect, c: Coordinate, sensitivities: Sensitivities) -> tuple[Integers, Floats]:
    """(sightings, (s, 4, 2, 1) px per unit) of a linear parameter of a view effect that is the same in every frame."""
    node = {p.name: getattr(effect, p.name) for p in effect.parameters if p.role != "linear"}
    if c.index is not None:
        node[COUNT] = len(getattr(effect, c.name))
    rows, quads = sensitivities.derivative(type(effect), effect.place, Linear(c.name, c.index, c.step), node)
    return rows, quads[..., None]
