"""Places of an arm's axes in sentences, with the names that its joints have in other files."""

import re
from collections.abc import Sequence

PLACE = re.compile(r"\b(joint|slide) ([1-9]\d*)\b(?! \()")
PLACES = re.compile(r"\b((?:joint|slide)s) ([1-9]\d*(?:, [1-9]\d*)+)\b(?! \()")


def text_with_joint_names(text: str, names: Sequence[str]) -> str:
    """A text in which the name of each joint stands behind its place: "joint 5 (A4)".

    names : of the joints in order, () where they have none; numbers beyond them stay as they are
    """
    if not names:
        return text

    def name(number: str) -> str:
        k = int(number) - 1
        return f" ({names[k]})" if k < len(names) else ""

    def named(match: re.Match[str]) -> str:
        return f"{match[1]} " + ", ".join(number + name(number) for number in match[2].split(", "))

    return PLACE.sub(named, PLACES.sub(named, text))
