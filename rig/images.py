"""Whether an image file is whole and of the size its camera has, without decoding it."""

import struct

PNG, JPEG = b"\x89PNG\r\n\x1a\n", b"\xff\xd8\xff"


def check_image(path, camera):
    """What is wrong with an image file, in words, or None.

    path : file; camera : the Camera that took it. A PNG must end with its end chunk, a JPEG with its end marker; a PNG's
    size must be the camera's. Other formats are left to the decoder.
    """
    try:
        with open(path, "rb") as file:
            head = file.read(24)
            file.seek(0, 2)
            size = file.tell()
            file.seek(max(0, size - 64))
            tail = file.read()
    except FileNotFoundError:
        return "no such image"
    except OSError as error:
        return f"cannot be read: {error.strerror}"
    if not size:
        return "is an empty file"
    if head.startswith(PNG):
        if b"IEND\xaeB`\x82" not in tail or size < 57:
            return f"is cut off after {size} bytes (a PNG without its end)"
        got = struct.unpack(">II", head[16:24])
        if got != (camera.width, camera.height):
            return f"is {got[0]} x {got[1]} px, but camera {camera.name!r} has {camera.width} x {camera.height} px"
    elif head.startswith(JPEG) and b"\xff\xd9" not in tail:
        return f"is cut off after {size} bytes (a JPEG without its end)"
    return None
