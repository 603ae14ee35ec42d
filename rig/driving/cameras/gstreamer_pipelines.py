"""Pipelines of GStreamer as rig.toml may name them: what reads, decodes and converts, ending in appsink; nothing that
writes.
"""

import re

READING = re.compile(r"(?!wrapper)[a-z0-9]+src")
CONVERTING = re.compile(
    r"[a-z0-9]+(dec|depay|parse|demux|convert|convertscale|conv|postproc)|avdec_[a-z0-9]+|decodebin3?|bayer2rgb|"
    r"capsfilter|queue|rtpjitterbuffer|video(scale|rate|flip|crop|balance|box)|deinterlace"
)
END = "appsink"
SETTING = re.compile(r"[A-Za-z][A-Za-z0-9_-]*=[^\s!\"'\\()<>{}\[\];]+")
VALUE = r"(\([a-z]+\))?[A-Za-z0-9_.:/+-]+"
CAPS = re.compile(rf"(video|image)/[a-z0-9.+-]+(\(memory:[A-Za-z]+\))?(\s*,\s*[a-z-]+\s*=\s*{VALUE})*")


def pipeline_complaint(pipeline: str) -> str | None:
    """Why a pipeline is refused, in words that follow its name; None for one that only reads, decodes and converts, and
    ends in appsink.

    Elements are known by name, settings are NAME=VALUE without quotes or blanks, what is asked of the video is as
    video/x-raw,width=640
    """
    parts = [part.strip() for part in pipeline.split("!")]
    for number, part in enumerate(parts):
        if CAPS.fullmatch(part) and 0 < number < len(parts) - 1:
            continue
        element, *settings = part.split() or [""]
        last = number == len(parts) - 1
        if last and element != END:
            return f"ends in {element!r}, and must end in {END}"
        if not last and ("sink" in element or not (READING.fullmatch(element) or CONVERTING.fullmatch(element))):
            return (
                f"names {element!r}; only elements that read, decode or convert images are opened, since others "
                "may write files"
            )
        wrong = next((one for one in settings if not SETTING.fullmatch(one)), None)
        if wrong is not None:
            return f"has {wrong!r} after {element}, which is no setting NAME=VALUE"
    return None if len(parts) > 1 else f"must name where images come from, then ! {END}"
