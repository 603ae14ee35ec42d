"""A Python file of the user's own, read and run.

Errors name the file, the line and what is missing.

The file is run: it is a program, to be trusted as one. A file behind a URL is never run.
"""

import ast
import sys
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from traceback import extract_tb
from types import ModuleType
from typing import TypeVar

from rig.errors import FileError
from rig.formats.local_and_remote_input_files import is_remote

T = TypeVar("T")
SMALL = 1 << 20  # bytes of such a file


@dataclass(frozen=True, slots=True, eq=False)
class UserModule:
    """A file that was run. text : of it; sha256 : of its bytes; module : what it defined"""

    path: Path
    text: str
    sha256: str
    module: ModuleType

    def classes(self, base: type[T]) -> list[type[T]]:
        """Classes derived from a base that the file itself defines."""
        return [
            kind
            for kind in vars(self.module).values()
            if isinstance(kind, type) and issubclass(kind, base) and kind.__module__ == self.module.__name__
        ]

    def line(self, kind: type[object], field: str | None = None) -> int | None:
        """Line that defines a class, or a name in its body; None where that is not at the file's top level."""
        return line_of_class(self.text, kind.__name__, field)


def read_user_text_and_sha256(path: Path) -> tuple[str, str]:
    """Read the text of a user's Python file, with its SHA-256.

    Returns (text, SHA-256 of the bytes)
    Raises FileError, with the line for what is no text.
    """
    if is_remote(path):
        raise FileError(path, "is a program behind a URL, and such a program is not run: copy it to this computer")
    try:
        raw = path.read_bytes()
        if len(raw) > SMALL:
            raise FileError(path, f"has {len(raw)} bytes, more than the {SMALL} that such a file may have")
        return raw.decode("utf-8"), sha256(raw).hexdigest()
    except OSError as error:
        raise FileError(path, f"cannot be read: {error.strerror}") from None
    except UnicodeDecodeError as error:
        raise FileError(path, f"is not text in UTF-8: {error.reason}", raw[: error.start].count(b"\n") + 1) from None


def run_user_text_as_module(text: str, path: Path) -> ModuleType:
    """Run a source text of the user's as a module.

    path : its name in errors.
    Raises FileError with the line.
    """
    module = ModuleType(f"user_file_{sha256(str(path).encode() + text.encode()).hexdigest()[:16]}")
    module.__file__ = str(path)
    sys.modules[module.__name__] = module  # dataclasses look their module up by its name
    try:
        exec(compile(text, str(path), "exec"), vars(module))
    except SyntaxError as error:
        raise FileError(path, f"is no Python: {error.msg}", error.lineno, error.offset) from None
    except Exception as error:
        raise FileError(
            path, f"cannot be run: {type(error).__name__}: {error}", line_in_file_of_error(error, path)
        ) from None
    return module


def load_user_module(path: Path) -> UserModule:
    """UserModule (text, digest and module) of a user's Python file, which is run.

    Raises FileError, with the line, where it cannot be read or run.
    """
    text, digest = read_user_text_and_sha256(path)
    return UserModule(path, text, digest, run_user_text_as_module(text, path))


def line_in_file_of_error(error: BaseException, path: Path | str) -> int | None:
    """Last line of a file in the traceback of an error.

    None for none.
    """
    lines = [frame.lineno for frame in extract_tb(error.__traceback__) if frame.filename == str(path)]
    return lines[-1] if lines else None


def line_of_class(text: str, name: str, field: str | None = None) -> int | None:
    """Line where a source text defines a class.

    Or a name in its body.
    None where that is not at its top level.
    """
    for node in ast.parse(text).body:
        if isinstance(node, ast.ClassDef) and node.name == name:
            lines = [part.lineno for part in node.body if field in _names(part)] if field else [node.lineno]
            return lines[0] if lines else node.lineno
    return None


def literal_in_class_body(text: str, field: str) -> object:
    """Value of a literal in a class body of a source text.

    Such as `urgent_stop = b"!"`, in the first class body that has one; None for none.

    Nothing is run.
    """
    try:
        classes = [node for node in ast.parse(text).body if isinstance(node, ast.ClassDef)]
        parts = [part for node in classes for part in node.body if field in _names(part)]
        values = [part.value for part in parts]  # type: ignore[attr-defined]
        return ast.literal_eval(values[0]) if values and values[0] is not None else None
    except (SyntaxError, ValueError):
        return None


def _names(node: ast.stmt) -> list[str]:
    """Names that a statement of a class body assigns."""
    targets = node.targets if isinstance(node, ast.Assign) else [node.target] if isinstance(node, ast.AnnAssign) else []
    return [target.id for target in targets if isinstance(target, ast.Name)]
