"""The notebooks, run from top to bottom, and their outputs stored: `python -m docs.make.notebooks`."""

import ast
import io
import json
import os
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any

FOLDER = Path(__file__).parents[1] / "notebooks"


def executed(path: Path) -> dict[str, Any]:
    """The tree of a notebook with the outputs that its cells have now; the working folder is as it was before."""
    tree, names, before = json.loads(path.read_text(encoding="utf-8")), {}, os.getcwd()
    number = 0
    try:
        for cell in tree["cells"]:
            if cell["cell_type"] == "code":
                number += 1
                cell["execution_count"], cell["outputs"] = number, _outputs("".join(cell["source"]), names, number)
    finally:
        os.chdir(before)
    return tree


def _outputs(source: str, names: dict[str, Any], number: int) -> list[dict[str, Any]]:
    """What a cell prints and what it ends with, as a notebook stores them. names : of the cells so far, changed"""
    *body, last = ast.parse(source).body
    value, printed = None, io.StringIO()
    with redirect_stdout(printed):
        if isinstance(last, ast.Expr):
            exec(compile(ast.Module(body, []), "cell", "exec"), names)
            value = eval(compile(ast.Expression(last.value), "cell", "eval"), names)
        else:
            exec(compile(ast.Module([*body, last], []), "cell", "exec"), names)
    out: list[dict[str, Any]] = []
    if printed.getvalue():
        out.append({"name": "stdout", "output_type": "stream", "text": printed.getvalue().splitlines(keepends=True)})
    if value is not None:
        shown = value._repr_html_() if hasattr(value, "_repr_html_") else None
        plain = str(value) if shown and type(value).__str__ is not object.__str__ else repr(value)
        if shown and plain == repr(value):  # all its arrays, of which a notebook shows the HTML
            plain = f"<{type(value).__name__}>"
        data = {"text/plain": plain.splitlines(keepends=True)}
        if shown:
            data["text/html"] = shown.splitlines(keepends=True)
        out.append({"data": data, "execution_count": number, "metadata": {}, "output_type": "execute_result"})
    return out


def page(path: Path) -> str:
    """A notebook as a page in Markdown: its text, its code and the outputs that are stored in it."""
    parts = []
    for cell in json.loads(path.read_text(encoding="utf-8"))["cells"]:
        source = "".join(cell["source"])
        parts.append(source if cell["cell_type"] == "markdown" else f"```python\n{source}\n```")
        for output in cell.get("outputs", ()):
            data = output.get("data", {})
            shown = "".join(data.get("text/html", ())).replace("\n", " ")
            plain = "".join(output.get("text") or data["text/plain"]).rstrip()
            parts.append(shown or f"```text\n{plain}\n```")
    file = f"[{path.name}]({path.name})"
    return "\n\n".join([*parts, f"This page is the notebook {file}, with the outputs stored in it."]) + "\n"


def main() -> None:
    """Run all notebooks and store their outputs."""
    for path in sorted(FOLDER.glob("*.ipynb")):
        tree = executed(path)
        path.write_text(json.dumps(tree, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
