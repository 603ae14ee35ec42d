"""One input to one reader, within limits; and inputs made out of valid ones."""

import json
import resource
import signal
import warnings
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from rig.errors import RigError
from tests.fuzz.readers import Reader

SECONDS = 1.0  # CPU time of a reader on one input, so that a busy machine makes no false alarm
BYTES = 1 << 30  # beyond what the process has when it begins
LONGEST = 1 << 16  # bytes of an input
TOKENS = tuple(
    t.encode("utf-8", "surrogateescape")
    for t in (
        "1e308",
        "-1e308",
        "1e-400",
        "1e999",
        "nan",
        "-inf",
        "Infinity",
        "9" * 20,
        "9" * 5000,
        "0x" + "f" * 5000,
        "-1",
        "0",
        "1e15",
        "18446744073709551616",
        "\u00b2",
        "\u0661",
        "1_0",
        "true",
        "null",
        "{}",
        "[]",
        "[" * 400,
        '{"a":' * 400,
        "[[]]",
        '""',
        "'",
        '"',
        '"""',
        "\\u0000",
        "\0",
        "\udcff",
        "\ufeff",
        "../../x",
        "/dev/zero",
        "$\\bad$",
        "left cam",
        ",",
        ",,",
        "\n",
        "\r",
        "\r\n",
        "\u2028",
        "=",
        ":",
        "/",
        "#",
        "a" * 300,
        "x" * 40000,
        "1979-05-27",
        "07:32:00",
        "1e5",
        "0.0",
        "strut 0",
        "strut 9",
        "e",
        "E",
        "+",
        "1.",
        ".5",
        "NaN",
        "inf",
        "[[camera]]",
        'kind = "arm"\n',
        "\t",
    )
)


VALUES = (
    None,
    True,
    0,
    -1,
    0.5,
    1e308,
    -1e308,
    float("nan"),
    float("inf"),
    10**18,
    10**30,
    10**400,
    "",
    "x",
    "0",
    "\u00b2",
    "strut 9",
    "nothing",
    [],
    {},
    [[]],
    [0],
    [0] * 6,
    [[0] * 6] * 6,
    [0] * 42,
    {"a": 1},
    [None] * 6,
    ["x"] * 6,
    1e-300,
    2**53 + 1,
    "\0",
    "../../x",
)
KINDS = (
    0.08,
    0.08,
    0.08,
    0.08,
    0.55,
    0.13,
)  # of changes: taken away, doubled, a byte, from another, a word, a word put in


class TooLong(Exception):
    """A reader took longer than SECONDS."""


@contextmanager
def confined():
    """Within, readers have BYTES more of memory, and warnings are errors."""

    def over(*_):
        raise TooLong

    size = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    before, was = signal.signal(signal.SIGPROF, over), resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (size + BYTES, was[1]))
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, was)
        signal.signal(signal.SIGPROF, before)


def failure(reader: Reader, data: bytes, path: Path) -> str | None:
    """What a reader, confined, did wrong with an input, put into a file at path, in words; None where it read it or
    raised a RigError.
    """
    path.write_bytes(data)
    signal.setitimer(signal.ITIMER_PROF, SECONDS)
    try:
        reader.read(path)
    except RigError:
        return None
    except Exception as error:
        at = error.__traceback__
        while at.tb_next is not None:
            at = at.tb_next
        return (
            f"{type(error).__name__}: {str(error)[:200]} ({Path(at.tb_frame.f_code.co_filename).name}:{at.tb_lineno})"
        )
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
    return None


def mutated(data: bytes, others: tuple[bytes, ...], rng: np.random.Generator) -> bytes:
    """An input near a valid one: a few of its bytes, numbers and parts changed, doubled, taken away, or from
    another.
    """
    tree = _tree(data) if rng.random() < 0.6 else None
    if tree:
        return _other_tree(tree, rng)[:LONGEST]
    out = bytearray(data)
    for _ in range(int(rng.geometric(0.6))):
        a, b = sorted(rng.integers(0, len(out) + 1, 2).tolist())
        b = min(b, a + int(rng.choice([1, 4, 16, 64, 4096])))
        kind = rng.choice(6, p=KINDS)
        if kind == 0:
            out[a:b] = b""
        elif kind == 1:
            out[a:a] = out[a:b]
        elif kind == 2 and out:
            out[a % len(out)] = int(rng.integers(256))
        elif kind == 3:
            other = others[rng.integers(len(others))]
            start = int(rng.integers(0, len(other) + 1))
            out[a:b] = other[start : start + b - a]
        else:
            token = TOKENS[rng.integers(len(TOKENS))]
            low, high = _word(out, a) if kind == 4 else (a, a)
            out[low:high] = token
    return bytes(out[:LONGEST])


def _tree(data):
    """The dict of a JSON text, or None for what is none."""
    try:
        tree = json.loads(data) if data[:1] == b"{" else None
    except (ValueError, RecursionError):
        return None
    return tree if isinstance(tree, dict) else None


def _other_tree(tree, rng):
    """The text of a JSON tree one of whose branches is another value."""
    at = tree
    while True:
        keys = list(at) if isinstance(at, dict) else range(len(at))
        if not len(keys):
            break
        key = keys[rng.integers(len(keys))]
        if isinstance(at[key], dict | list) and rng.random() < 0.8:
            at = at[key]
            continue
        value = VALUES[rng.integers(len(VALUES))]
        if rng.random() < 0.2 and isinstance(at, list):
            at.insert(int(key), value)
        elif rng.random() < 0.2:
            del at[key]
        else:
            at[key] = value
        break
    return json.dumps(tree).encode()


def _word(data, at):
    """(start, end) of the number or word that stands at a place."""
    stop = b" ,\n\r\t:=[]{}\"'/"
    low = high = at
    while low > 0 and data[low - 1] not in stop:
        low -= 1
    while high < len(data) and data[high] not in stop:
        high += 1
    return low, high
