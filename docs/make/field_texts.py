"""What docstrings tell, as text of tables: of a dataclass's fields the lines "name, name : words; name : words"."""

import inspect
import re

_NAMES = re.compile(r"(?:^|[;.] |;?\n)[ ]*((?:[a-z_]\w*, )*[a-z_]\w*) : ")


def texts_of_fields(kind: type) -> dict[str, str]:
    """{field: what the docstring says of it}, in one line each."""
    text = inspect.cleandoc(kind.__doc__ or "")
    parts = _NAMES.split(text)
    texts = {}
    for names, words in zip(parts[1::2], parts[2::2]):
        for name in names.split(", "):
            texts[name] = one_line(words)
    return texts


def one_line(text: str) -> str:
    """Text with its line breaks and what breaks a table taken out."""
    return " ".join(text.split()).rstrip(".;").replace("|", "\\|")


def in_cell(text: str, marks: str = "|*_<") -> str:
    """Text in a cell of a table, marks of Markdown shown as they are."""
    for mark in marks:
        text = text.replace(mark, {"<": "&lt;", "|": "&#124;"}.get(mark, "\\" + mark))
    return text


def headline(kind: type) -> str:
    """What a docstring says before it comes to the fields."""
    return " ".join(_NAMES.split(inspect.cleandoc(kind.__doc__ or "").split("\n\n")[0])[0].split()).rstrip(".;") + "."
