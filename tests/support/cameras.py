# Checks for tests/test_view.sh how the mouse and the keys have moved the camera. FOLDER contains the printed cameras;
# the window has W x H pixels, and each drag was by 40 pixels to the right from the middle of the window.
#     cameras.py FOLDER W H
import math
import os
import sys


def add(a, b, times):
    return [x + times * y for x, y in zip(a, b)]


def dot(a, b):
    return sum(x * y for x, y in zip(a, b))


def cross(a, b):
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def unit(v):
    return [x / math.sqrt(dot(v, v)) for x in v]


class Camera:
    def __init__(self, folder, name):
        words = open(os.path.join(folder, name + ".camera")).read().split()
        numbers = {key: [float(x) for x in value.split(",")] for key, value in zip(words[0::2], words[1::2]) if
                   key != "--size"}
        self.eye, self.fov = numbers["--eye"], numbers["--fov"][0]
        self.forward = unit(add(numbers["--look-at"], self.eye, -1))
        self.right = unit(cross(self.forward, numbers["--up"]))


def turned(v, angle):
    """Returns v, rotated about y."""
    c, s = math.cos(angle), math.sin(angle)
    return [c * v[0] + s * v[2], v[1], c * v[2] - s * v[0]]


def check(name, found, wanted, scale=1.0):
    """Both are vectors or numbers; cameras have six digits."""
    found, wanted = ([x] if isinstance(x, float) else x for x in (found, wanted))
    if max(abs(x - y) for x, y in zip(found, wanted)) > 1e-4 * scale:
        sys.exit("%s: %s instead of %s" % (name, found, wanted))


def main(folder, width, height):
    names = "start wheel home look orbit shift 1 ahead 2 right 3 up".split()
    start, wheel, home, look, orbit, shift, *held = [Camera(folder, name) for name in names]
    size = math.sqrt(dot(home.eye, home.eye))
    angle = 2 * math.pi / (width + height)  # of a drag by one pixel

    step = add(wheel.eye, start.eye, -1)
    check("wheel: the direction of the step", unit(step), start.forward, 30)
    check("wheel: what it looks at", wheel.forward, start.forward)

    check("right button: position", look.eye, home.eye, size)
    check("right button: direction", look.forward, turned(home.forward, -20 * angle))

    # orbit.eye = pivot + R (look.eye - pivot) for a rotation R about y, so that (R - 1) (look.eye - pivot) is known
    turn = -40 * angle
    check("left button: direction", orbit.forward, turned(look.forward, turn))
    check("left button: height", orbit.eye[1], look.eye[1], size)
    c, s, x, z = math.cos(turn) - 1, math.sin(turn), *(orbit.eye[k] - look.eye[k] for k in (0, 2))
    to_eye = [(c * x - s * z) / (c * c + s * s), 0, (s * x + c * z) / (c * c + s * s)]
    level = unit([look.forward[0], 0, look.forward[2]])
    if not -dot(unit(to_eye), level) > 0.999:
        sys.exit("left button: the pivot is in the direction %s instead of %s" % ([-x for x in unit(to_eye)], level))

    # the pivot is in the middle of the picture, so that its distance along `level` tells its depth
    depth = -dot(to_eye, level) / dot(look.forward, level)
    pixel = 2 * depth * math.tan(math.radians(look.fov) / 2) / height
    check("middle button: position", shift.eye, add(orbit.eye, orbit.right, -40 * pixel), 300 * pixel)

    for i, (name, way) in enumerate((("up", shift.forward), ("right", shift.right), ("page up", [0, 1, 0]))):
        moved = add(held[2 * i + 1].eye, held[2 * i].eye, -1)
        if name == "page up":
            way = cross(shift.right, shift.forward)
        check(name + ": the direction of the step", unit(moved), way, 100)


main(sys.argv[1], int(sys.argv[2]), int(sys.argv[3]))
