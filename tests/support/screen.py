# Compares the content of a virtual screen with pictures, for tests/test_view.sh. The screen is a file in the format of
# X window dumps, which Xvfb writes with -fbdir. The window is in the upper left corner.
#     screen.py shot SCREEN W H OUT.ppm          copies the window
#     screen.py same A B [MOST]                  fails if a byte differs by more than MOST (default 0)
#     screen.py differ A B LEAST                 fails unless the mean difference of bytes is at least LEAST
#     screen.py closer A B TRUTH                 fails unless B is closer to TRUTH than A is
#     screen.py count A R,G,B SLACK LEAST        fails unless at least LEAST pixels have this colour within SLACK
#     screen.py brighter A B                     fails unless the mean of B exceeds that of A by 5
import struct
import sys
import zlib


def of_screen(path, width, height):
    with open(path, "rb") as file:
        data = file.read()
    head = struct.unpack(">25I", data[:100])
    start, line = head[0] + 12 * head[19], head[12]
    rows = [data[start + y * line:start + y * line + 4 * width] for y in range(height)]
    return width, height, b"".join(bytes(row[4 * x + k] for x in range(width) for k in (2, 1, 0)) for row in rows)


def of_png(data):
    at, packed = 8, b""
    while at < len(data):
        length, kind = struct.unpack(">I4s", data[at:at + 8])
        if kind == b"IHDR":
            width, height = struct.unpack(">II", data[at + 8:at + 16])
        if kind == b"IDAT":
            packed += data[at + 8:at + 8 + length]
        at += 12 + length
    raw, line, out, above = zlib.decompress(packed), 3 * width, b"", bytearray(3 * width)
    for y in range(height):
        kind = raw[y * (line + 1)]
        row = bytearray(raw[y * (line + 1) + 1:(y + 1) * (line + 1)])
        for x in range(line):
            a, b, c = row[x - 3] if x >= 3 else 0, above[x], above[x - 3] if x >= 3 else 0
            if kind == 4:
                far = abs(b - c), abs(a - c), abs(a + b - 2 * c)
                guess = (a, b, c)[far.index(min(far))]
            else:
                guess = (0, a, b, (a + b) // 2)[kind]
            row[x] = (row[x] + guess) & 255
        out, above = out + row, row
    return width, height, out


def read(path):
    with open(path, "rb") as file:
        data = file.read()
    if data[:2] != b"P6":
        return of_png(data)
    head, size, _, rest = data.split(b"\n", 3)
    return (*map(int, size.split()), rest)


def mean(a, b):
    if a[:2] != b[:2]:
        sys.exit("sizes %s and %s" % (a[:2], b[:2]))
    return sum(abs(x - y) for x, y in zip(a[2], b[2])) / len(a[2])


def main(what, *rest):
    if what == "shot":
        width, height = int(rest[1]), int(rest[2])
        with open(rest[3], "wb") as file:
            file.write(b"P6\n%d %d\n255\n" % (width, height) + of_screen(rest[0], width, height)[2])
        return
    a = read(rest[0])
    if what == "count":
        color, slack = [int(x) for x in rest[1].split(",")], int(rest[2])
        found = sum(all(abs(a[2][i + k] - color[k]) <= slack for k in range(3)) for i in range(0, len(a[2]), 3))
        ok, text = found >= int(rest[3]), "%d pixels of %s" % (found, rest[1])
    elif what == "same":
        b = read(rest[1])
        worst = max(abs(x - y) for x, y in zip(a[2], b[2])) if a[:2] == b[:2] else 256
        ok, text = worst <= (int(rest[2]) if len(rest) > 2 else 0), "largest difference %d" % worst
    elif what == "differ":
        far = mean(a, read(rest[1]))
        ok, text = far >= float(rest[2]), "mean difference %.3f" % far
    elif what == "closer":
        far = mean(a, read(rest[2])), mean(read(rest[1]), read(rest[2]))
        ok, text = far[1] < far[0], "mean differences %.3f and %.3f" % far
    else:
        b = read(rest[1])
        means = sum(a[2]) / len(a[2]), sum(b[2]) / len(b[2])
        ok, text = means[1] > means[0] + 5, "means %.1f and %.1f" % means
    print(" ".join((what, *rest)) + ": " + text)
    sys.exit(not ok)


main(*sys.argv[1:])
