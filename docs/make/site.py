"""MkDocs hooks: pages made from the code join those that are written, and formulae become MathML, which browsers show
by themselves.
"""

import html
import re
import sys
from pathlib import Path
from typing import Any

from latex2mathml.converter import convert
from mkdocs.structure.files import File, Files

ROOT = Path(__file__).parents[2]
FORMULA = re.compile(r'<(span|div) class="arithmatex">\\([(\[])(.*?)\\[)\]]</\1>', re.DOTALL)
TAG = re.compile(r"\\tag\{(\w+)\}")
SEARCH = 'data-md-component="search" role="dialog"'
sys.path[:0] = [str(ROOT)]  # the pages are made from this tree


def on_files(files: Files, config: Any) -> Files:
    """Add the pages and the diagrams that are made from the code, and the changes."""
    from docs.make import api, dependency_diagram, messages

    made = {
        "troubleshooting.md": messages.page(),
        "api.md": api.page(),
        "dependencies.md": dependency_diagram.page(),
        "changelog.md": (ROOT / "CHANGELOG.md").read_text(encoding="utf-8").replace("](docs/", "]("),
    }
    for name, content in made.items():
        files.append(File.generated(config, name, content=content))
    for name in dependency_diagram.DIAGRAMS:
        files.append(File.generated(config, f"dependencies/{name}.svg", content=dependency_diagram.diagram(name)))
    return files


def on_page_content(text: str, **_: Any) -> str:
    """Formulae of a page's HTML as MathML, numbered ones with their number beside."""
    return FORMULA.sub(_formula, text)


def on_post_page(output: str, **_: Any) -> str:
    """The theme's dialog of the search with a name, which readers of screens say."""
    return output.replace(SEARCH, f'{SEARCH} aria-label="Search"')


def _formula(found: re.Match) -> str:
    block, latex = found[2] == "[", html.unescape(found[3])
    number = TAG.search(latex)
    made = convert(TAG.sub("", latex).strip(), display="block" if block else "inline")
    if not block:
        return made
    return (
        f'<div class="formula" role="math">{made}'
        + (f'<span class="number">({number[1]})</span>' if number else "")
        + "</div>"
    )
