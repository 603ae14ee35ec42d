"""The page of messages: every refusal that the code can utter, by the kind of error, and every mistake that it
recognises, with what to do.

Made when the documents are built, by reading the code: nothing of it is run.
"""

import ast
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from docs.make.field_texts import in_cell
from tests.calib.checks.matrix import CASES

ROOT = Path(__file__).parents[2]
PACKAGES = ("rig", "vision", "calib", "synthetic")
HEAD = """# Troubleshooting, by message

Look for the words of a message that do not change; what does change from case to case is written `..` here. Of a \
message `FILE:LINE:COLUMN: words`
only the words stand here.

First of all `rig check REC`: it says everything that is wrong or unlikely with a recording at once, the likeliest \
cause first, with what to do.
A file that cannot be used is named with line and column. Nothing is written where something was refused.
"""
KINDS = "rig/errors.py"
ADVICE = {  # what helps with every error of a kind
    "RigError": "The message says what was got and what is taken; `rig COMMAND --help` says the rest.",
    "FileError": "Open the file at the line and column that are named; [rig.toml](rig-toml.md) and [the "
    "tables](tables.md) say what may stand there.",
    "NotConverged": "The geometry and what was measured contradict each other: `rig check REC` "
    "first, then at the frames "
    "listed (`rig view`).",
    "Unreachable": "Each pose is listed with what stops it. Leave these out "
    "(`--skip-unreachable`) or plan them nearer to "
    "home.",
    "NotEnoughData": "Take more frames, of more different poses; the message says how many there "
    "are and how many it takes.",
    "MissingLibrary": "Install the package that is named; everything that does not need it works without.",
    "MotionError": "Look at the machine first. [Controllers](controllers.md) say how each kind "
    "of controller ends such a "
    "state.",
    "LinkLost": "Look at the cable and at `[controller] port`; `rig status RIG.toml` says "
    "whether it answers again. `rig "
    "run --resume` goes on.",
    "NoAnswer": "Is it the right protocol, port and baudrate? `--trace FILE` keeps every byte.",
    "ControllerFault": "Its own manual explains what it said; see what is wrong at the machine, "
    "then `rig home --unlock`.",
    "Stalled": "Look for what is in the way; then `rig status`, `rig home`.",
    "PositionLost": "`rig home`, or `--trust` where the struts truly stand as they read.",
    "Stopped": "Somebody asked for it; `rig run --resume` goes on.",
}


@dataclass(frozen=True, slots=True)
class Message:
    """words : what does not change of it; kind : of the error; module : in which it is said"""

    words: str
    kind: str
    module: str


@dataclass(frozen=True, slots=True)
class MistakeText:
    """A mistake that is recognised, as it is said: what it is, and what to do."""

    what: str
    do: str


def page() -> str:
    """The page in Markdown."""
    parts = [HEAD, "\n## Mistakes that are recognised\n\n| message | what to do |\n|---|---|\n"]
    named = sorted(
        {mistake for mistake in mistakes() if mistake.do != ".."},
        key=lambda mistake: (mistake.what.startswith(".."), mistake.what, mistake.do),
    )
    parts += [f"| {_cell(mistake.what)} | {_cell(mistake.do)} |\n" for mistake in named]
    parts.append(
        "\nAmong what people did to sound recordings and what is named so (the tests do each): "
        f"{'; '.join(case.name for case in CASES)}.\n"
    )
    sorted_messages, kinds = (
        sorted(set(messages()), key=lambda m: (m.words.lstrip(". ").lower(), m.words, m.module)),
        error_kinds(),
    )
    for kind, words in kinds.items():
        mine = [m for m in sorted_messages if m.kind == kind]
        if mine:
            parts.append(f"\n## {kind}\n\n{words}\n\n{ADVICE[kind]}\n\n| message | said by |\n|---|---|\n")
            parts += [f"| {_cell(m.words)} | {m.module} |\n" for m in mine]
    return "".join(parts)


def error_kinds() -> dict[str, str]:
    """{kind: what it is} of the errors there are, from the first sentence of each docstring."""
    tree = ast.parse((ROOT / KINDS).read_text())
    return {
        node.name: " ".join((ast.get_docstring(node) or "").split("\n\n")[0].split())
        for node in tree.body
        if isinstance(node, ast.ClassDef)
    }


def messages() -> Iterator[Message]:
    """Every message with which the code raises an error of its own kinds, or a reader of files refuses."""
    kinds = error_kinds()
    for path, call in _calls():
        name = ast.unparse(call.func).split(".")[-1]
        if name in kinds and call.args:
            given = call.args[1] if name == "FileError" and len(call.args) > 1 else call.args[0]
        elif name == "fail" and call.args:
            name, given = "FileError", call.args[0]
        else:
            continue
        for words in fixed(given):
            yield Message(words, name, path)


def mistakes() -> Iterator[MistakeText]:
    """Every Mistake that the code can name."""
    for _, call in _calls():
        if ast.unparse(call.func).split(".")[-1] == "Mistake" and len(call.args) >= 2:
            for what in fixed(call.args[0]):
                yield MistakeText(what, next(fixed(call.args[1]), ".."))


@cache
def _calls() -> list[tuple[str, ast.Call]]:
    paths = [path for package in PACKAGES for path in sorted((ROOT / package).rglob("*.py"))]
    return [
        (str(path.relative_to(ROOT)), node)
        for path in paths
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Call)
    ]


def fixed(node: ast.expr) -> Iterator[str]:
    """What does not change of a text that an expression makes, each of its alternatives; nothing where all of it
    changes.
    """
    if isinstance(node, ast.IfExp):
        yield from fixed(node.body)
        yield from fixed(node.orelse)
        return
    words = " ".join(_words(node).split())
    while ".. .." in words or "...." in words:
        words = words.replace(".. ..", "..").replace("....", "..")
    if sum(letter.isalpha() for letter in words) >= 8:
        yield words


def _words(node: ast.expr) -> str:
    if isinstance(node, ast.Constant):
        return str(node.value)
    if isinstance(node, ast.JoinedStr):
        return "".join(_words(part) for part in node.values)
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add):
        return _words(node.left) + _words(node.right)
    return ".."


def _cell(text: str) -> str:
    return in_cell(text, "\\|*_<[]`")
