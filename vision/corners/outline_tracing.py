"""Outlines of what is dark in a picture of zeros and ones, outer ones and those of holes, followed from pixel to pixel.

Source: border following, Suzuki and Abe, Computer Vision, Graphics, and Image Processing 30, 1985, algorithm 1
"""

import numpy as np

from vision.corners.numba_compilation import kernel, kernel_part
from vision.corners.outline_quadrangles import Traced, quadrangle_of_outline

FRESH, SEEN, RIGHT = 1, 2, 130  # of a dark pixel: on no outline yet, on one, and on one whose right neighbour is bright
_X = np.array([1, 1, 0, -1, -1, -1, 0, 1])  # a pixel's neighbours, from the right one on against the clock
_Y = np.array([0, -1, -1, -1, 0, 1, 1, 1])
_EACH = np.uint64(0x0101010101010101)  # the lowest bit of each of a word's eight pixels
_1, _7, _8, _56, _0 = (np.uint64(k) for k in (1, 7, 8, 56, 0))


@kernel
def trace_quadrangles(words: np.ndarray, marks: np.ndarray, least: int, traced: Traced, found: np.ndarray) -> int:
    """Write the corners of all outlines that are quadrangles to found (k, 4, 2), int32 pixels; returns how many there
    are.

    words, marks : (rows, columns / 8) uint64 and (rows, columns) uint8, the same memory: of `darker`, overwritten
    least : pixels of an outline, fewer of which are no marker's; as many as traced has room for are the most. Of
    quadrangles that found has no room for only the number is told
    """
    flat, stride, count = marks.reshape(marks.size), marks.shape[1], 0
    around = np.empty(8, np.int64)
    for k in range(8):
        around[k] = _Y[k] * stride + _X[k]
    for y in range(1, marks.shape[0] - 1):
        before, row = _0, words[y]
        for j in range(np.uintp(len(row))):
            if before | row[j] == _0:
                continue
            done = _0  # bits of the pixels that were looked at
            while True:
                word = row[j]
                outer, hole = _starts(word, before)
                starts = (outer | hole) & ~done
                if starts == _0:
                    break
                first = starts & (~starts + _1)
                done = (first << _8) - _1
                at = y * stride + 8 * j + _place(first)
                if outer & first:
                    pixels = _follow(flat, stride, around, at, 4, traced)
                else:
                    pixels = _follow(flat, stride, around, at - 1, 0, traced)
                if least <= pixels <= len(traced.x):
                    count += quadrangle_of_outline(traced, pixels, found, count)
            before = word >> _56
    return count


@kernel_part
def _starts(word: np.uint64, before: np.uint64) -> tuple[np.uint64, np.uint64]:
    """Bits, of _EACH, of pixels of a word before which outlines begin: dark ones after a bright one, on none yet, and
    bright ones after a dark one.

    before : the pixel before the word
    """
    dark = (word | word >> _1) & _EACH
    bright = dark ^ _EACH
    left = dark & ~(word >> _7)  # dark, and not told to end to the right
    last = (before | before >> _1) & _1
    return word & _EACH & (bright << _8 | last ^ _1), bright & (left << _8 | last & ~(before >> _7))


@kernel_part
def _place(bit: np.uint64) -> int:
    """Number of the pixel in a word that a bit of _EACH is of."""
    place = 0
    while bit > _1:
        bit >>= _8
        place += 1
    return place


@kernel_part
def _follow(flat: np.ndarray, stride: int, around: np.ndarray, start: int, bright: int, traced: Traced) -> int:
    """Mark the pixels of an outline from `start` on, as `flat` counts them; returns how many, of which traced has as
    many as it has room for.

    around : (8,) by how much neighbours are off; bright : number of the neighbour that is bright, 4 for an outer
        outline, 0 for one of a hole
    """
    most, count = len(traced.x), 0
    side = bright
    while True:
        side = (side - 1) & 7
        last = start + around[side]
        if flat[last] != 0 or side == bright:
            break
    if flat[last] == 0:
        flat[start] = RIGHT  # a pixel by itself
        return 1
    here = start
    x, y = start % stride - 1, start // stride - 1
    while True:
        came = side
        ahead = here
        while True:
            side += 1
            ahead = here + around[side & 7]
            if flat[ahead] != 0:
                break
        side &= 7
        if 0 < side <= came:
            flat[here] = RIGHT
        elif flat[here] == FRESH:
            flat[here] = SEEN
        if count < most:
            traced.x[count], traced.y[count] = x, y
        count += 1
        if ahead == start and here == last:
            return count
        x, y, here = x + _X[side], y + _Y[side], ahead
        side = (side + 4) & 7
