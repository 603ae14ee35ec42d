"""docs/gallery.md out of the scripts in docs/gallery, each with what it prints: `python -m docs.make.gallery`."""

import ast
import io
import os
import re
import runpy
import tempfile
from contextlib import redirect_stdout
from pathlib import Path

FOLDER = Path(__file__).parents[1] / "gallery"
PAGE = FOLDER.with_suffix(".md")
ORDER = (
    "new_rig", "plan", "simulate", "check", "measure", "calibrate", "correct", "verify", "certify", "diagnose",
    "watch", "why",
)  # fmt: skip
HEAD = """# Gallery: short scripts

Made from the scripts in `docs/gallery` (`python -m docs.make.gallery`). Each runs by itself in an empty folder and
simulates its machine. For your own machine, omit the lines that simulate, and give its recording folder to `rig.load`.
The last digits may differ on another computer.

![Position error of 24 poses: about 1.6 mm by the nominal model, mostly below 0.3 mm corrected](figures/errors.svg)

The figure shows what *calibrate* and *verify* below compare: the error of each pose before and after correction.
"""
PRINTED = re.compile(r"^## .*?\(gallery/(\w+)\.py\).*?^```text\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def printed(script: Path) -> str:
    """What a script prints, run in an empty folder; the working folder is as it was before."""
    before, out = os.getcwd(), io.StringIO()
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        try:
            with redirect_stdout(out):
                runpy.run_path(str(script))
        finally:
            os.chdir(before)
    return out.getvalue()


def stored(page: str) -> dict[str, str]:
    """{name of a script: what a page says that it prints}."""
    return dict(PRINTED.findall(page))


def page(outputs: dict[str, str]) -> str:
    """The page in Markdown. outputs : {name of a script: what it prints}"""
    return "\n".join([HEAD, *(_section(name, outputs[name]) for name in ORDER)])


def _section(name: str, output: str) -> str:
    source = (FOLDER / f"{name}.py").read_text(encoding="utf-8")
    says = ast.get_docstring(ast.parse(source))
    code = source.split('"""\n', 1)[1].strip()
    return (
        f"## {name.replace('_', ' ').capitalize()}\n\n{says} ([{name}.py](gallery/{name}.py))\n\n"
        f"```python\n{code}\n```\n\nIt prints:\n\n```text\n{output}```\n"
    )


def main() -> None:
    """Run all scripts and write the page."""
    PAGE.write_text(page({name: printed(FOLDER / f"{name}.py") for name in ORDER}), encoding="utf-8")


if __name__ == "__main__":
    main()
