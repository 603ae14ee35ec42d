"""Numbers as people read them: so many significant digits, and no power of ten where digits do."""

MOST = 7  # digits by which two values may be told apart
PLAIN = 1e6  # from which a power of ten is the shorter


def rounded(value: float, digits: int = 3) -> str:
    """A value to so many significant digits; one above 10^digits to its last digit before the point.

    >>> rounded(1139.6), rounded(0.0123456), rounded(-0.5)
    ('1140', '0.0123', '-0.5')
    """
    text = f"{value:.{digits}g}"
    return f"{float(text):.0f}" if "e+" in text and abs(value) < PLAIN else text


def apart(low: float, high: float, digits: int = 3) -> int:
    """The fewest significant digits, `digits` or more, that tell two values apart.

    >>> apart(199.81, 200.3), apart(1.0, 2.0)
    (4, 3)
    """
    return next((n for n in range(digits, MOST) if rounded(low, n) != rounded(high, n)), digits)
