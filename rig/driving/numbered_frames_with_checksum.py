"""Lines of text with a number and a checksum, so that answers belong to requests and nothing broken is read."""

import binascii
import re
from dataclasses import dataclass

_FRAME = re.compile(r"([<>])(-|\d{1,5}) ([^*<>!]*)\*([0-9A-F]{4})")


@dataclass(frozen=True, slots=True)
class Frame:
    """number : of the request, None where a broken frame is complained of; text : without number and checksum."""

    number: int | None
    text: str


def encode_frame(direction: str, number: int | None, text: str) -> bytes:
    """Encode a numbered text as a frame. direction : ">" to the controller, "<" from it.
    direction : ">" to the controller, "<" from it.
    """
    body = f"{'-' if number is None else number} {text}"
    return f"{direction}{body}*{_checksum(body)}\n".encode("ascii")


def last_valid_frame_in_line(direction: str, line: str) -> Frame | None:
    """Decode the last valid frame in a line, None where there is none."""
    for match in reversed(list(_FRAME.finditer(line))):
        if match[1] == direction and match[4] == _checksum(f"{match[2]} {match[3]}"):
            return Frame(None if match[2] == "-" else int(match[2]), match[3])
    return None


def _checksum(body: str) -> str:
    """CRC-16/CCITT-FALSE of a frame's body, four hexadecimal digits."""
    return f"{binascii.crc_hqx(body.encode('latin-1'), 0xFFFF):04X}"
