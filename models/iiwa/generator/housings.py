"""The look of the arm: one coloured mesh per link, shaped after an LBR iiwa.

Each bent joint (2, 4) is made of two half drums side by side on the joint's axis, one per link,
so that the drums bulge to alternating sides; the forearm (link 5) holds the wrist drum from one
side. Lengths in metres, in the frame of the link.
"""

from generator.palette import Material
from generator.solids import (
    Mesh,
    Solid,
    cone,
    cylinder,
    difference,
    join,
    lathe,
    rounded_box,
    surface,
    union,
)

SILVER = Material((0.85, 0.86, 0.88), 0.0, 0.45)
GREY = Material((0.45, 0.46, 0.48), 0.0, 0.5)
DARK = Material((0.07, 0.07, 0.08), 0.1, 0.6)
ORANGE = Material((1.0, 0.36, 0.0), 0.0, 0.5)
BLUE = Material((0.25, 0.75, 1.0), 0.0, 0.3)

_R = 0.067  # tubes and drums
_CELL = 0.0085
_GAP = 0.002
_REACH = 0.113  # outer face of a drum, from the centre line
_FORK = 0.098  # outer face of the forearm's fork

Parts = list[tuple[Material, Mesh]]


def _drum_link(length: float, joint: float, side: float) -> Solid:
    """Tube along z from 0 to ``length`` with a half drum at height ``joint`` (an end of it)."""
    end = length - joint  # the other end of the tube
    inner = end + 0.55 * (joint - end)
    lean = end + 0.70 * (joint - end)
    tube = cylinder((0, 0, end), (0, 0, inner), _R, 0.003)
    neck = cone((0, 0, inner), (0, side * 0.035, lean), _R - 0.010, _R - 0.016)
    drum = cylinder((0, -side * 0.03, joint), (0, side * _REACH, joint), _R, 0.032)
    body = union(union(tube, neck, 0.03), drum, 0.038)
    mate = cylinder((0, side * _GAP, joint), (0, -side * 0.3, joint), _R + 0.004, 0.002)
    beyond = cylinder((0, side * _REACH, joint), (0, side * 0.3, joint), 0.3, 0.002)
    return difference(difference(body, mate, 0.008), beyond, 0.003)


def _drum_parts(joint: float, side: float, accent: Material) -> Parts:
    """Cover on the outer face of a drum, and the dark ring between it and the next drum."""
    axis = "y" if side > 0 else "-y"
    cover = [(0.038, -0.003), (0.038, 0.0015), (0.036, 0.0030), (0.029, 0.0030), (0.029, 0.0015)]
    disc = [(0.029, 0.0015), (0.0, 0.0015)]
    face = (0, side * _REACH, joint)
    return [
        (accent, lathe(cover, axis, face)),
        (GREY, lathe(disc, axis, face)),
        (DARK, lathe(_ring(_R + 0.001, 0.006), axis, (0, 0, joint))),
    ]


def _ring(radius: float, half: float) -> list[tuple[float, float]]:
    """Profile of a flat disc with chamfered rim."""
    rim = radius - 0.001
    side = half - 0.001
    return [(0, -half), (rim, -half), (radius, -side), (radius, side), (rim, half), (0, half)]


def _seam(height: float, radius: float = _R + 0.001) -> Mesh:
    """Dark ring over the gap between two tubes."""
    return lathe(_ring(radius, 0.006), "z", (0, 0, height))


def _upper(length: float, side: float, accent: Material) -> Parts:
    """Links 1 and 3: the joint to the next link is at the top."""
    solid = _drum_link(length, length, side)
    shell = surface(solid, (-0.075, -0.12, -0.01), (0.075, 0.12, length + 0.08), _CELL)
    return [(SILVER, shell), *_drum_parts(length, side, accent)]


def _lower(length: float, side: float, accent: Material) -> Parts:
    """Links 2 and 4: the joint to the previous link is at the bottom, a seam at the top."""
    solid = _drum_link(length, 0.0, side)
    shell = surface(solid, (-0.075, -0.12, -0.08), (0.075, 0.12, length + 0.01), _CELL)
    return [(SILVER, shell), *_drum_parts(0.0, side, accent), (DARK, _seam(length))]


def _base() -> Parts:
    foot = cylinder((0, 0, -0.02), (0, 0, 0.03), 0.105, 0.006)
    body = union(foot, cone((0, 0, 0.03), (0, 0, 0.09), 0.088, 0.062), 0.05)
    body = union(body, cylinder((0, 0, 0.03), (0, 0, 0.148), _R, 0.005), 0.03)
    body = union(body, rounded_box((-0.066, 0, 0.04), (0.10, 0.11, 0.08), 0.014), 0.02)
    body = difference(body, cylinder((0, 0, -0.3), (0, 0, -0.004), 0.3), 0.002)
    shell = surface(body, (-0.125, -0.115, -0.01), (0.115, 0.115, 0.155), 0.009)
    plug = surface(
        rounded_box((-0.114, 0, 0.04), (0.012, 0.075, 0.045), 0.003),
        (-0.125, -0.04, 0.01),
        (-0.10, 0.04, 0.07),
        0.006,
    )
    return [(SILVER, shell), (DARK, join([_seam(0.150), plug]))]


def _forearm(length: float) -> Parts:
    tube = cylinder((0, 0, 0.0), (0, 0, 0.07), _R, 0.005)
    neck = cone((0, 0, 0.06), (0, -0.050, length - 0.045), _R - 0.006, 0.042)
    hub = cylinder((0, -_FORK, length), (0, -0.03, length), 0.052, 0.012)
    body = union(union(tube, neck, 0.03), hub, 0.045)
    wrist = cylinder((0, -0.058, length), (0, 0.3, length), _R + 0.006, 0.002)
    beyond = cylinder((0, -_FORK, length), (0, -0.3, length), 0.3, 0.002)
    body = difference(difference(body, wrist, 0.008), beyond, 0.003)
    shell = surface(body, (-0.075, -0.11, -0.01), (0.075, 0.08, 0.26), _CELL)
    cover = [(0.034, -0.003), (0.034, 0.0015), (0.032, 0.0025), (0.0, 0.0025)]
    return [(SILVER, shell), (GREY, lathe(cover, "-y", (0, -_FORK, length)))]


def _wrist(length: float) -> Parts:
    drum = cylinder((0, -0.053, 0), (0, 0.085, 0), 0.066, 0.032)
    body = union(drum, cylinder((0, 0, 0), (0, 0, length - _GAP), 0.0465, 0.002), 0.025)
    beyond = cylinder((0, 0.085, 0), (0, 0.3, 0), 0.3, 0.002)
    body = difference(body, beyond, 0.003)
    shell = surface(body, (-0.075, -0.065, -0.075), (0.075, 0.095, length), 0.007)
    ring = [(0.038, -0.003), (0.038, 0.0015), (0.036, 0.003), (0.029, 0.003), (0.029, 0.0015)]
    return [
        (SILVER, shell),
        (ORANGE, lathe(ring, "y", (0, 0.085, 0))),
        (GREY, lathe([(0.029, 0.0015), (0.0, 0.0015)], "y", (0, 0.085, 0))),
        (DARK, join([lathe(_ring(0.050, 0.004), "y", (0, -0.056, 0)), _seam(length, 0.0475)])),
    ]


def _flange(height: float) -> Parts:
    """Flange of ISO 9409-1-50: disc, light ring, screws on a circle of 50 mm diameter."""
    lower, upper = height - 0.022, height - 0.018
    disc = [(0.0, 0.003), (0.047, 0.003), (0.049, 0.006), (0.049, lower), (0.0475, lower)]
    top = [(0.0475, upper), (0.043, height - 0.008), (0.0315, height - 0.008)]
    top += [(0.0315, height), (0.0, height)]
    light = [(0.0475, lower), (0.0480, lower), (0.0480, upper), (0.0475, upper)]
    return [
        (SILVER, lathe(disc, "z")),
        (GREY, lathe(top, "z")),
        (BLUE, lathe(light, "z")),
    ]


def link_parts(index: int, length: float) -> Parts:
    """Coloured parts of a link whose next joint (or the flange) is ``length`` above its frame."""
    builders = {
        0: _base,
        1: lambda: _upper(length, -1.0, GREY),
        2: lambda: _lower(length, 1.0, ORANGE),
        3: lambda: _upper(length, 1.0, GREY),
        4: lambda: _lower(length, -1.0, ORANGE),
        5: lambda: _forearm(length),
        6: lambda: _wrist(length),
        7: lambda: _flange(length),
    }
    return builders[index]()
