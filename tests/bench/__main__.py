"""Print every benchmark but those that take minutes, or those named: python -m tests.bench [way forward ...]."""

import sys

from tests.bench import false_findings, masks, several_faults, truth
from tests.bench.benchmark_list import ALL, NAMED


def main() -> None:
    """Run the benchmarks and print a line each: figure, reached, wanted; of those with options, their campaign."""
    campaigns = {"truth": truth, "masks": masks, "false_findings": false_findings, "several_faults": several_faults}
    campaign = campaigns.get(sys.argv[1]) if sys.argv[2:3] and sys.argv[2].startswith("-") else None
    if campaign is not None:
        campaign.main(sys.argv[2:])
        return
    for name in sys.argv[1:] or ALL:
        if name not in NAMED:
            sys.exit(f"no benchmark {name!r}; there are {', '.join(NAMED)}")
        print(f"\n== {name}: {NAMED[name].__doc__.splitlines()[0]}")
        for figure, reached, wanted in NAMED[name].rows():
            print(f"{figure:78} {reached:>34}   {wanted}", flush=True)


main()
