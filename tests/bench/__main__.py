"""Print every benchmark but those that take minutes, or those named: python -m tests.bench [way forward ...]."""

import sys

from tests.bench import (
    absent,
    arm_physics,
    arms,
    beside,
    certificate,
    correction,
    corners,
    diagnosis,
    driving,
    formula,
    forward,
    growing,
    images,
    investigate,
    lens,
    method,
    parameters,
    physics,
    reach,
    scale,
    watch,
    way,
)

ALL = {"way": way, "forward": forward, "absent": absent, "lens": lens, "corners": corners, "parameters": parameters, "arms": arms,
       "diagnosis": diagnosis, "growing": growing, "driving": driving, "correction": correction}
NAMED = {**ALL, "certificate": certificate, "reach": reach, "physics": physics, "arm_physics": arm_physics, "method": method,
         "formula": formula, "images": images, "beside": beside, "watch": watch, "investigate": investigate,
         "scale": scale}  # minutes: only where they are named


def main() -> None:
    """Run the benchmarks and print a line each: figure, reached, wanted."""
    for name in sys.argv[1:] or ALL:
        if name not in NAMED:
            sys.exit(f"no benchmark {name!r}; there are {', '.join(NAMED)}")
        print(f"\n== {name}: {NAMED[name].__doc__.splitlines()[0]}")
        for figure, reached, wanted in NAMED[name].rows():
            print(f"{figure:78} {reached:>34}   {wanted}", flush=True)


main()
