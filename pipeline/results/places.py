"""Words for a piece of surface: size, extents and place, as a person would point at it."""

from __future__ import annotations

from math import atan2, degrees, hypot

_DIRECTIONS = (
    "ahead",
    "ahead left",
    "left",
    "behind left",
    "behind",
    "behind right",
    "right",
    "ahead right",
)


def size_word(length_m: float, width_m: float, height_m: float) -> str:
    """A word for the size of a box with horizontal sides length >= width.

    Examples
    --------
    >>> [size_word(*box) for box in ((4.2, 1.8, 1.5), (0.6, 0.4, 1.7), (0.3, 0.2, 4.0), (12, 0.4, 2), (9, 8, 6))]
    ['car-sized', 'person-sized', 'pole', 'wall', 'large']
    """
    sizes = {
        "pole": height_m >= 1.5 and length_m <= height_m / 4,
        "person-sized": 0.8 <= height_m <= 2.2 and length_m <= 1.2,
        "wall": length_m >= 3 and height_m >= 1 and width_m <= length_m / 8,
        "flat": height_m <= 0.4 and length_m >= 1,
        "car-sized": 2.5 <= length_m <= 5.5 and width_m <= 4.5 and 0.8 <= height_m <= 2.4,
        "small": length_m <= 1 and height_m <= 1,
        "tree-sized": height_m >= 2 and length_m <= height_m,
        "bush-sized": length_m <= 3,
    }
    return next((word for word, fits in sizes.items() if fits), "large")


def direction(bearing_deg: float) -> str:
    """One of eight directions; 0 is ahead, positive to the left.

    Examples
    --------
    >>> [direction(angle) for angle in (10, 60, -90, 179, -170)]
    ['ahead', 'ahead left', 'right', 'behind', 'behind']
    """
    return _DIRECTIONS[round(bearing_deg / 45) % 8]


def place_words(
    label: str | None, extents_m: tuple[float, float, float], range_m: float, bearing_deg: float
) -> str:
    """Class or size, extents and place.

    Examples
    --------
    >>> place_words(None, (4.2, 1.8, 1.5), 7.2, 40)
    'car-sized, 4.2 x 1.8 x 1.5 m, 7 m ahead left'
    """
    width, length = sorted(extents_m[:2])
    height = extents_m[2]
    size = f"{length:.1f} x {width:.1f} x {height:.1f} m"
    what = label or size_word(length, width, height)
    return f"{what}, {size}, {range_m:.0f} m {direction(bearing_deg)}"


def moved_words(x_m: float, y_m: float, z_m: float) -> str:
    """Distance and direction of a piece that moved.

    Examples
    --------
    >>> moved_words(0.1, -0.5, 0.0), moved_words(0, 0.1, -0.4)
    ('moved by 0.5 m to the right', 'moved by 0.4 m down')
    """
    horizontal = hypot(x_m, y_m)
    if abs(z_m) > horizontal:
        where = "up" if z_m > 0 else "down"
    else:
        where = direction(degrees(atan2(y_m, x_m)))
        where = f"to the {where}" if where in ("left", "right") else where
    return f"moved by {hypot(horizontal, z_m):.1f} m {where}"
