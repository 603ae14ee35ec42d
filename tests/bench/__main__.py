"""Print every benchmark, or those named: python -m tests.bench [way forward ...]."""

import sys

from tests.bench import absent, arms, corners, diagnosis, forward, lens, parameters, way

ALL = {"way": way, "forward": forward, "absent": absent, "lens": lens, "corners": corners, "parameters": parameters, "arms": arms,
       "diagnosis": diagnosis}


def main():
    """Run the benchmarks and print a line each: figure, reached, wanted."""
    for name in sys.argv[1:] or ALL:
        if name not in ALL:
            sys.exit(f"no benchmark {name!r}; there are {', '.join(ALL)}")
        print(f"\n== {name}: {ALL[name].__doc__.splitlines()[0]}")
        for figure, reached, wanted in ALL[name].rows():
            print(f"{figure:78} {reached:>34}   {wanted}", flush=True)


main()
