"""docs/pages/*.webp: a picture of every page that commands write, in headless Chromium.

`python -m docs.make.pictures [FOLDER]`, where FOLDER, a new one, keeps the project whose pages they are; it takes the
extra `browser` and Chromium.
"""

import io
import math
import re
import shutil
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from PIL import Image

from docs.make import project

PICTURES = Path(__file__).parents[1] / "pages"
WIDE, NARROW, HIGH = 900, 400, 1250  # px, of a page on a computer, on a phone, and of what is shown of both
ON_PHONES = ("measure", "diagnose", "watch")  # beside which stands what a phone shows, dark
QUALITY, BETWEEN = 60, 24  # of WebP; px
SHOWN, PATIENCE = 12, 180  # frames of a run before its page is taken, s that it may take


def main(folder: Path) -> None:
    """Write all pictures, with the project in a new folder."""
    pages = project.quick(folder) | project.slow(folder)
    PICTURES.mkdir(exist_ok=True)
    with browser() as opened:
        for kind, page in pages.items():
            seen = [_screenshot(opened, page.as_uri(), WIDE, "light")]
            seen += [_screenshot(opened, page.as_uri(), NARROW, "dark")] if kind in ON_PHONES else []
            _side_by_side(seen).save(PICTURES / f"{kind}.webp", quality=QUALITY, method=6)
        with project.running(folder) as address:
            _side_by_side([_screenshot(opened, address, WIDE, "light", SHOWN)]).save(
                PICTURES / "run.webp", quality=QUALITY, method=6
            )


def chromium() -> str | None:
    """Where Chromium is."""
    return shutil.which("chromium") or shutil.which("google-chrome")


@contextmanager
def browser() -> Iterator[Any]:
    """Headless Chromium. Raises RuntimeError where there is none"""
    from playwright.sync_api import sync_playwright

    found = chromium()
    if found is None:
        raise RuntimeError("needs Chromium: apt-get install chromium")
    with sync_playwright() as driver:
        opened = driver.chromium.launch(executable_path=found, args=["--no-sandbox"])
        yield opened
        opened.close()


def _screenshot(opened: Any, address: str, width: int, scheme: str, frames: int = 0) -> Image.Image:
    """A picture of a page's beginning. frames : of a run, for which it is waited"""
    context = opened.new_context(viewport={"width": width, "height": HIGH}, color_scheme=scheme)
    seen = context.new_page()
    seen.goto(address, wait_until="domcontentloaded" if frames else "load")
    until = time.monotonic() + PATIENCE
    while frames and not frames <= int((re.search(r"frame (\d+) of", seen.inner_text("#far")) or "00")[1]):
        if time.monotonic() > until:
            raise RuntimeError(f"the run's page still says: {seen.inner_text('header')}")
        time.sleep(0.1)
    high = min(HIGH, math.ceil(seen.evaluate("document.body.getBoundingClientRect().bottom")) + BETWEEN)
    picture = seen.screenshot(clip={"x": 0, "y": 0, "width": width, "height": high}, full_page=True)
    context.close()
    return Image.open(io.BytesIO(picture)).convert("RGB")


def _side_by_side(pictures: list[Image.Image]) -> Image.Image:
    """Pictures from left to right, on white."""
    out = Image.new(
        "RGB",
        (sum(p.width for p in pictures) + BETWEEN * (len(pictures) - 1), max(p.height for p in pictures)),
        "white",
    )
    at = 0
    for picture in pictures:
        out.paste(picture, (at, 0))
        at += picture.width + BETWEEN
    return out


if __name__ == "__main__":
    if len(sys.argv) > 1:
        main(Path(sys.argv[1]))
    else:
        with TemporaryDirectory() as name:
            main(Path(name) / "project")
