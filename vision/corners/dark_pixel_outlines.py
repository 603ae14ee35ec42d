"""Dark pixels by adaptive thresholds, and tracing of their outlines into quadrangles.

one pass over the image each.

Source: adaptive thresholds in three windows, as OpenCV's ArUco reader takes them, Garrido-Jurado et al., Pattern
    Recognition 47, 2014

Source: border following, Suzuki and Abe, Computer Vision, Graphics, and Image Processing 30, 1985, algorithm 1
"""

import numpy as np

from rig.arrays import Floats, ImageBytes, Integers, Pixels
from vision.corners.numba_compilation import inlined_kernel, kernel
from vision.corners.quadrangle_candidates import OutlineBuffers, write_outline_quadrangle

WINDOWS = (3, 13, 23)  # px, odd
BY = 7  # grey levels, by which the mean, rounded, has to be brighter
LEFT = 1  # columns and rows of zeros before the image's own


@kernel
def mark_dark_pixels(image: Pixels, window: int, out: ImageBytes) -> None:
    """Mark the pixels of an image that are darker than the mean of their window, 1 in out, else 0.

    window : px, of WINDOWS. The image goes on beyond its border as it is there. out : zeros beyond the image's own
        pixels
    """
    height, width = image.shape
    r, room = window // 2, np.uintp(width + window)
    sums = np.zeros((3, room), np.uint16)  # down the window's rows; these over two columns, and over four
    one = sums[0]
    for k in range(-r, r + 1):
        row = image[min(max(k, 0), height - 1)]
        for x in range(np.uintp(width)):
            one[x + np.uintp(r)] += row[x]
    for y in range(height):
        if y > 0:
            fresh, gone = image[min(y + r, height - 1)], image[max(y - r - 1, 0)]
            for x in range(np.uintp(width)):
                one[x + np.uintp(r)] += np.uint16(fresh[x]) - np.uint16(gone[x])
        for k in range(r):
            one[k], one[r + width + k] = one[r], one[r + width - 1]
        _compare(image[y], sums, window, out[y + LEFT])


@inlined_kernel
def _compare(row: Floats, sums: Integers, window: int, out: Floats) -> None:
    """out (width + 2 or more): which pixels of an image row are darker, by sums (3, width + window); sums of two and
    four columns are overwritten.
    """
    one, two, four, width = sums[0], sums[1], sums[2], np.uintp(len(row))
    x1, x2, x4, x8, x12, x16 = np.uintp(1), np.uintp(2), np.uintp(4), np.uintp(8), np.uintp(12), np.uintp(16)
    area = window * window
    more = (area * (2 * BY - 1)) // 2  # the mean is rounded: what is brighter by half a level less does
    for x in range(width + np.uintp(window - 1)):
        two[x] = one[x] + one[x + x1]
    if window > 3:
        for x in range(width + np.uintp(window - 4)):
            four[x] = two[x] + two[x + x2]
    if window == 3:
        for x in range(width):
            out[x + x1] = np.uint16(two[x] + one[x + x2]) > np.uint16(area * row[x] + more)
    elif window == 13:
        for x in range(width):
            out[x + x1] = np.uint16(four[x] + four[x + x4] + four[x + x8] + one[x + x12]) > np.uint16(
                area * row[x] + more
            )
    else:
        for x in range(width):
            total = (
                np.int32(four[x])
                + np.int32(four[x + x4])
                + np.int32(four[x + x8])
                + np.int32(four[x + x12])
                + np.int32(four[x + x16])
            )
            total += np.int32(two[x + np.uintp(20)]) + np.int32(one[x + np.uintp(22)])
            out[x + x1] = np.int32(total) > np.int32(area * row[x] + more)


FRESH, SEEN, RIGHT = 1, 2, 130  # of a dark pixel: on no outline yet, on one, and on one whose right neighbour is bright
_X = np.array([1, 1, 0, -1, -1, -1, 0, 1])  # a pixel's neighbours, from the right one on against the clock
_Y = np.array([0, -1, -1, -1, 0, 1, 1, 1])
_EACH = np.uint64(0x0101010101010101)  # the lowest bit of each of a word's eight pixels
_1, _7, _8, _56, _0 = (np.uint64(k) for k in (1, 7, 8, 56, 0))


@kernel
def trace_quadrangles(words: Floats, marks: ImageBytes, least: int, traced: OutlineBuffers, found: Integers) -> int:
    """Trace all outlines and write the corners of quadrangles to found (k, 4, 2), px; returns their count.

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
                    count += write_outline_quadrangle(traced, pixels, found, count)
            before = word >> _56
    return count


@inlined_kernel
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


@inlined_kernel
def _place(bit: np.uint64) -> int:
    """Number of the pixel in a word that a bit of _EACH is of."""
    place = 0
    while bit > _1:
        bit >>= _8
        place += 1
    return place


@inlined_kernel
def _follow(flat: ImageBytes, stride: int, around: Integers, start: int, bright: int, traced: OutlineBuffers) -> int:
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
