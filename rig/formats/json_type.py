"""The type Json: a table of a JSON, TOML or YAML file."""

from typing import Any

Json = dict[
    str, Any
]  # a table of a file: numbers, words, lists and tables by their names, known only once they are read
