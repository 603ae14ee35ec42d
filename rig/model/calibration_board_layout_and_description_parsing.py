"""Layout of calibration boards, and parsing of their description.

ChArUco, ArUco grid, AprilGrid.
Kalibr's AprilGrid; their printed layout, parsed from their description.
"""

from dataclasses import dataclass

import numpy as np

from rig.array_and_json_types import Booleans, Floats
from rig.errors import RigError
from rig.formats.numbers_and_units import SI, LengthAndAngleUnits, parse_quantity, parse_whole_number

DICTIONARIES = {  # how many identities each dictionary of OpenCV holds
    **{f"DICT_{bits}X{bits}_{count}": count for bits in (4, 5, 6, 7) for count in (50, 100, 250, 1000)},
    "DICT_ARUCO_ORIGINAL": 1024,
    "DICT_ARUCO_MIP_36h12": 250,
    "DICT_APRILTAG_16h5": 30,
    "DICT_APRILTAG_25h9": 35,
    "DICT_APRILTAG_36h10": 2320,
    "DICT_APRILTAG_36h11": 587,
}
KINDS = {
    "charuco": "charuco:COLUMNSxROWS:SQUARE:MARKER:DICTIONARY (squares)",
    "aruco": "aruco:COLUMNSxROWS:SIDE:GAP:DICTIONARY (markers)",
    "aprilgrid": "aprilgrid:COLUMNSxROWS:SIDE:GAP:DICTIONARY (markers)",
}
LARGEST = 5.0  # m
CORNERS = np.array([[-0.5, -0.5, 0], [0.5, -0.5, 0], [0.5, 0.5, 0], [-0.5, 0.5, 0]])  # clockwise as seen, y down


@dataclass(frozen=True, slots=True, eq=False)
class Board:
    """kind of KINDS; columns, rows : squares, or markers; pitch : m from one to the next; side : m, a marker's
    dictionary : OpenCV name; legacy : whether a charuco's first square holds a marker where its rows are even."""

    kind: str
    columns: int
    rows: int
    pitch: float
    side: float
    dictionary: str
    legacy: bool = False

    @property
    def size(self) -> tuple[float, float]:
        """Width and height (m): of a charuco all its squares, else from the outermost edges of its markers."""
        less = 0.0 if self.kind == "charuco" else self.pitch - self.side
        return self.columns * self.pitch - less, self.rows * self.pitch - less

    @property
    def margin(self) -> float:
        """White paper (m) about each marker: to the edge of its square, else half the way to the next marker."""
        return (self.pitch - self.side) / 2

    @property
    def points(self) -> Floats:
        """(n, 3) m, corners that are measured: x right, y down, z = 0; of a charuco its inner corners row by row, else
        markers' four.
        """
        if self.kind == "charuco":
            x, y = np.meshgrid(np.arange(1, self.columns), np.arange(1, self.rows))
            return np.stack([x.ravel() * self.pitch, y.ravel() * self.pitch, 0.0 * x.ravel()], axis=1)
        return self.marker_corners().reshape(-1, 3)

    def places(self) -> Floats:
        """(m, 2) m, middles of the markers in the order of their identities, x right, y down from the top left."""
        x, y = self._grid()
        if self.kind == "charuco":
            white = self._is_white()
            return (np.stack([x[white], y[white]], axis=1) + 0.5) * self.pitch
        upwards = self.kind == "aprilgrid"  # Kalibr's tag 0 is at the lower left
        return np.stack([x, self.rows - 1 - y if upwards else y], axis=1) * self.pitch + self.side / 2

    def black_squares(self) -> Floats:
        """(n, 2) m, middles of the squares of side `pitch` that a charuco's chessboard has black, as places."""
        if self.kind != "charuco":
            return np.zeros((0, 2))
        black = ~self._is_white()
        return (np.stack(self._grid(), axis=1)[black] + 0.5) * self.pitch

    def in_board_frame(self, places: Floats) -> Floats:
        """(m, 3) m of places (m, 2): origin at the board's lower left corner, x right, y up, z out of the paper."""
        return np.stack([places[:, 0], self.size[1] - places[:, 1], np.zeros(len(places))], axis=1)

    def marker_corners(self) -> Floats:
        """(m, 4, 3) m, corners of the markers, clockwise from the top left; x right, y down."""
        middles = np.pad(self.places(), ((0, 0), (0, 1)))
        return middles[:, None] + self.side * CORNERS

    def _grid(self) -> tuple[Floats, Floats]:
        x, y = np.meshgrid(np.arange(self.columns), np.arange(self.rows))
        return x.ravel().astype(float), y.ravel().astype(float)

    def _is_white(self) -> Booleans:
        """(columns * rows,) bool, squares of a chessboard that hold markers."""
        x, y = self._grid()
        return (x + y + (self.rows % 2 == 0 if self.legacy else 0)) % 2 == 1


def parse_board(text: str, units: LengthAndAngleUnits = SI) -> Board:
    """Parse a board's description text into a Board.

    units : of its lengths
    Raises RigError saying what is wrong with which part.
    """
    parts = text.split(":")
    kind = parts[0]
    if kind not in KINDS:
        raise RigError(f"board {text!r}: {kind!r} is no kind of board; there are {', '.join(KINDS.values())}")
    if len(parts) != 5:
        raise RigError(f"board {text!r} has {len(parts)} parts, not 5: {KINDS[kind]}")
    try:
        columns, rows = (parse_whole_number(part) for part in parts[1].lower().split("x"))
    except ValueError:
        raise RigError(f"board {text!r}: {parts[1]!r} is not a size such as 5x7") from None
    if not (columns * rows >= 2 and 1 <= columns <= 100 and 1 <= rows <= 100) or (
        kind == "charuco" and min(columns, rows) < 3
    ):
        raise RigError(f"board {text!r}: {columns}x{rows} is not a valid size of a {kind} board")
    first, second = (
        _length(text, name, part, units)
        for name, part in zip(("square", "marker") if kind == "charuco" else ("side", "gap"), parts[2:4])
    )
    if parts[4] not in DICTIONARIES:
        raise RigError(f"board {text!r}: {parts[4]!r} is no dictionary; there are {', '.join(DICTIONARIES)}")
    if kind == "charuco" and not second < first:
        raise RigError(
            f"board {text!r}: a marker of {units.shown(second, 'm')} does not fit into a square of "
            f"{units.shown(first, 'm')}; the square is stated first"
        )
    pitch, side = (first, second) if kind == "charuco" else (first + second, first)
    board = Board(kind, columns, rows, pitch, side, parts[4])
    if len(board.places()) > DICTIONARIES[board.dictionary]:
        raise RigError(
            f"board {text!r} has {len(board.places())} markers, {board.dictionary} only "
            f"{DICTIONARIES[board.dictionary]}"
        )
    return board


def _length(text: str, name: str, part: str, units: LengthAndAngleUnits) -> float:
    """A length of a description, in m."""
    try:
        length = parse_quantity(part, "m", units.per_si("m"))
    except ValueError:
        raise RigError(
            f"board {text!r}: {name} {part!r} is not a length, a number with its unit or in {units.length}"
        ) from None
    if not 0 < length <= LARGEST:
        stated = "in metres" if units == SI else f'in what units = "{units}" states'
        raise RigError(f"board {text!r}: {name} = {units.shown(length, 'm')} is implausible (lengths are {stated})")
    return length
