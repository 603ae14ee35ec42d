"""The benchmarks by name: the quick ones, and all."""

from tests.bench import (
    absent,
    accusations,
    arm_physics,
    arms,
    beside,
    certificate,
    corners,
    correction,
    diagnosis,
    driving,
    formula,
    forward,
    growing,
    images,
    investigate,
    lens,
    masks,
    method,
    parameters,
    physics,
    reach,
    scale,
    truth,
    verify,
    watch,
    way,
)

ALL = {"way": way, "forward": forward, "absent": absent, "lens": lens, "corners": corners, "parameters": parameters, "arms": arms,
       "diagnosis": diagnosis, "growing": growing, "driving": driving, "correction": correction}
NAMED = {**ALL, "certificate": certificate, "reach": reach, "physics": physics, "arm_physics": arm_physics, "method": method,
         "formula": formula, "images": images, "beside": beside, "watch": watch, "investigate": investigate,
         "scale": scale, "truth": truth, "verify": verify, "accusations": accusations,
         "masks": masks}  # minutes: only where they are named
