"""Print every benchmark but those that take minutes, or those named: python -m tests.bench [way forward ...]."""

import sys

from tests.bench import truth
from tests.bench.named import ALL, NAMED


def main() -> None:
    """Run the benchmarks and print a line each: figure, reached, wanted; of `truth` with options, its campaign."""
    if sys.argv[1:2] == ["truth"] and len(sys.argv) > 2:
        truth.main(sys.argv[2:])
        return
    for name in sys.argv[1:] or ALL:
        if name not in NAMED:
            sys.exit(f"no benchmark {name!r}; there are {', '.join(NAMED)}")
        print(f"\n== {name}: {NAMED[name].__doc__.splitlines()[0]}")
        for figure, reached, wanted in NAMED[name].rows():
            print(f"{figure:78} {reached:>34}   {wanted}", flush=True)


main()
