#!/usr/bin/env python3
"""Fits the tables of the specular lobe of sbl.h and prints them as C arrays.

    fit_lobe.py             prints the tables; a report of their errors goes to stderr
    fit_lobe.py --quick     the same without the report

The lobe is F D Vis with the distribution D of GGX (alpha = roughness^2), the height-correlated visibility of Smith
(Heitz 2014, "Understanding the masking-shadowing function") and the Fresnel term of Schlick,
F = f0 (1 - w) + w with w = (1 - V.H)^5. N is z, and V lies in the plane of x and z. mu is N.V.

Albedo table. E is the integral of D Vis cos over the hemisphere, and b is the integral of D Vis w cos. The albedo for
f0 is f0 (E - b) + b. Each entry contains E and b / (1 - mu)^5. The axes are
    x = mu (1 + alpha) / (mu + alpha)         the columns
    y = (roughness - 0.05) / 0.95             the rows
The dip of E at grazing angles is as wide as alpha, so that x and not mu is a good axis.

Table of cosines. Heitz, Dupuy, Hill and Neubelt 2016 ("Real-time polygonal-light shading with linearly transformed
cosines") show that the lobe D Vis cos is close to a clamped cosine whose directions a matrix transforms. The table
contains the inverse matrix, which takes L to the space of the cosine. V is (s, 0, mu) with s = sqrt(1 - mu^2):
    X = m0 x + m1 s z
    Y = y
    Z = m3 z - m2 s x
The integral of D Vis cos over a polygon is about E times the form factor of the transformed polygon, of which the part
above Z = 0 counts. Each entry contains m0, m1, m2, m3. The columns are sqrt(mu), and the rows are y as above. The
matrix does not depend on w. The fit minimises the integral of (p - q)^2 / (p + q) over all directions, where p is the
lobe, scaled to the integral 1, and q is the transformed cosine: the tails count as much as the peak, so that large
polygons have the right integral.

The tool needs numpy."""
import sys
import numpy as np

SIZE = 16          # entries along each axis of a table
ROUGHEST, SMOOTHEST = 1.0, 0.05


def gauss(count):
    """Points and weights of Gauss-Legendre quadrature on 0 to 1."""
    points, weights = np.polynomial.legendre.leggauss(count)
    return (points + 1) / 2, weights / 2


def smith(cosine, alpha):
    """Returns 1 plus the function Lambda of Smith for GGX."""
    return 0.5 * (1 + np.sqrt(1 + alpha * alpha * (1 - cosine * cosine) / (cosine * cosine)))


def lobe_directions(mu, alpha, count, turns):
    """Returns directions L with the density of the visible normals of GGX (Dupuy and Benyoub 2023: the stretched normal
    is the sum of V and a point that is uniform on a cap of the sphere), and their weights: the integral of D Vis g cos
    is the sum of weight times g. L.y is positive; each direction also stands for its mirror image. The arrays x, y, z,
    V.H and weight have the axes mu, height and turn."""
    height, height_weight = gauss(count)
    height, height_weight = height[None, :, None], height_weight[None, :, None]
    turn = (np.arange(turns) + 0.5)[None, None, :] / turns * np.pi
    mu = np.asarray(mu, float).reshape(-1, 1, 1)
    side = np.sqrt(1 - mu * mu)
    length = np.sqrt((alpha * side) ** 2 + mu * mu)
    stretched_x, stretched_z = alpha * side / length, mu / length
    z = (1 - height) * (1 + stretched_z) - stretched_z
    ring = np.sqrt(np.maximum(0, 1 - z * z))
    hx = alpha * (ring * np.cos(turn) + stretched_x)
    hy = alpha * ring * np.sin(turn)
    hz = np.maximum(z + stretched_z, 0) + 0 * turn
    length = np.sqrt(hx * hx + hy * hy + hz * hz)
    hx, hy, hz = hx / length, hy / length, hz / length
    vh = side * hx + mu * hz
    lx, ly, lz = 2 * vh * hx - side, 2 * vh * hy, 2 * vh * hz - mu
    above = lz > 0
    from_v, from_l = smith(mu, alpha), smith(np.where(above, lz, 1), alpha)
    weight = np.where(above, from_v / (from_v + from_l - 1), 0) * height_weight / turns
    return lx, ly, lz, vh, weight


def albedo(mu, roughness, count=200, turns=100):
    """Returns E and b for all mu at one roughness."""
    _, _, _, vh, weight = lobe_directions(mu, roughness * roughness, count, turns)
    w = np.clip(1 - vh, 0, 1) ** 5
    return weight.sum((1, 2)), (weight * w).sum((1, 2))


def matte_share(mu, count=200, turns=300):
    """Returns the mean of (1 - V.H)^5 over a Lambertian lobe."""
    z2, weight = gauss(count)
    z = np.sqrt(z2)[None, :, None]
    turn = (np.arange(turns) + 0.5)[None, None, :] / turns * np.pi
    mu = np.asarray(mu, float).reshape(-1, 1, 1)
    vl = mu * z + np.sqrt(1 - mu * mu) * np.sqrt(1 - z * z) * np.cos(turn)
    return ((1 - np.sqrt(np.maximum(0, 1 + vl) / 2)) ** 5).mean(2) @ weight


def hats(t, size=SIZE):
    """Returns weights of linear interpolation along one axis, with a row for each t and a column for each entry."""
    t = np.clip(t, 0, 1) * (size - 1)
    entry = np.minimum(t.astype(int), size - 2)
    rows = np.zeros((len(t), size))
    rows[np.arange(len(t)), entry] = 1 - (t - entry)
    rows[np.arange(len(t)), entry + 1] = t - entry
    return rows


def bilinear(x, y):
    """Returns the weights of all entries of a table for each point (x, y)."""
    return (hats(y)[:, :, None] * hats(x)[:, None, :]).reshape(len(x), -1)


def roughness_axis(roughness):
    return (roughness - SMOOTHEST) / (ROUGHEST - SMOOTHEST)


def albedo_axis(mu, roughness):
    alpha = roughness * roughness
    return mu * (1 + alpha) / (mu + alpha)


def bends():
    """Returns the quadratic form of the second differences of a table. It makes entries that no sample reaches continue
    the others."""
    second = np.eye(SIZE)[:-2] - 2 * np.eye(SIZE)[1:-1] + np.eye(SIZE)[2:]
    rows = np.vstack([np.kron(np.eye(SIZE), second), np.kron(second, np.eye(SIZE))])
    return rows.T @ rows


def solve_below(matrix, right, most):
    """Solves the equations; entries that would exceed `most` are held at `most`."""
    free = np.ones(len(right), bool)
    for _ in range(8):
        entries = np.full(len(right), most)
        rest = right[free] - most * matrix[np.ix_(free, ~free)].sum(1)
        entries[free] = np.linalg.solve(matrix[np.ix_(free, free)], rest)
        if entries.max() <= most: break
        free &= entries < most
    return np.minimum(entries, most)


def fit_table(rows, target, importance, rounds=25):
    """Returns entries from 0 to 1 whose interpolation minimises the maximum of importance times error (Lawson's method:
    least squares with weights that grow where the error is large)."""
    weight, best, least = importance ** 2, None, np.inf
    smooth = 1e-6 * bends()
    for _ in range(rounds):
        scaled = rows * weight[:, None]
        entries = solve_below(scaled.T @ rows + smooth, scaled.T @ target, 1.0)
        error = abs(rows @ entries - target) * importance
        if error.max() < least: best, least = entries, error.max()
        weight = weight * (error / error.max() + 0.05)
        weight /= (weight / importance ** 2).max()
    return np.clip(best, 0, 1)


def sample_grid():
    """Returns the samples to which the albedo table is fitted: mu, roughness, E, b."""
    mu = np.concatenate([[0.001, 0.003, 0.006, 0.01, 0.015], np.linspace(np.sqrt(0.02), 1, 76) ** 2])
    roughnesses = np.concatenate([np.linspace(0.05, 0.3, 26), np.linspace(0.32, 1, 35)])
    parts = [(mu, np.full(len(mu), r)) + albedo(mu, r) for r in roughnesses]
    return [np.concatenate(column) for column in zip(*parts)]


def round16(table):
    return np.round(table * 65535) / 65535


def fit_albedo():
    mu, roughness, e, b = sample_grid()
    rows = bilinear(albedo_axis(mu, roughness), roughness_axis(roughness))
    importance = np.where(mu < 0.019, 0.15, 1.0)
    grazing = (1 - mu) ** 5
    return round16(fit_table(rows, e, importance)), round16(fit_table(rows * grazing[:, None], b, importance))


def report_albedo(e_table, b_table):
    worst = np.zeros(3)
    mu, weight = gauss(48)
    mu = np.append(mu, np.random.default_rng(1).uniform(0.02, 0.2, 24))
    inside = mu >= 0.02
    for roughness in (0.05, 0.06, 0.08, 0.1, 0.15, 0.2, 0.25, 0.3, 0.4, 0.45, 0.5, 0.6, 0.7, 0.8, 0.9, 1):
        e, b = albedo(mu, roughness, 300, 150)
        same = np.full(len(mu), roughness)
        rows = bilinear(albedo_axis(mu, same), roughness_axis(same))
        e_fit, b_fit = rows @ e_table, rows @ b_table * (1 - mu) ** 5
        errors = [abs(v[inside]).max() for v in (e_fit - e, b_fit - b, e_fit - b_fit - e + b)]
        worst = np.maximum(worst, errors)
        sphere = [2 * (weight * mu[:48] * v[:48]).sum() for v in (e, e_fit, b, b_fit)]
        print("roughness %.2f: greatest error of E %.4f, b %.4f, a %.4f;" % ((roughness,) + tuple(errors)),
              "mean over a sphere of E %.5f (table %.5f), b %.5f (%.5f)" % tuple(sphere), file=sys.stderr)
    print("all: E %.4f, b %.4f, a %.4f" % tuple(worst), file=sys.stderr)


def sphere_means():
    """Returns the means of E and b over the picture of a sphere for the roughness of each row."""
    mu, weight = gauss(48)
    means = []
    for roughness in np.linspace(SMOOTHEST, ROUGHEST, SIZE):
        e, b = albedo(mu, roughness)
        means.append((2 * (weight * mu * e).sum(), 2 * (weight * mu * b).sum()))
    return np.array(means)


def fit_matte_share():
    """Returns the cubic polynomial of 1 - mu that is nearest to the matte share."""
    mu = (1 - np.cos(np.linspace(0, np.pi, 101))) / 2
    q = matte_share(mu)
    weight = np.ones(101)
    powers = np.vander(1 - mu, 4, increasing=True)
    for _ in range(40):
        cubic = np.linalg.lstsq(powers * np.sqrt(weight)[:, None], q * np.sqrt(weight), rcond=None)[0]
        error = abs(powers @ cubic - q)
        weight *= error / error.max() + 0.05
    points, weights = gauss(48)
    print("matte share: greatest error of the cubic %.5f, mean over a sphere %.6f" %
          (error.max(), 2 * (points * weights * matte_share(points)).sum()), file=sys.stderr)
    return cubic


def lobe(x, y, z, mu, alpha):
    """Returns D Vis cos for V = (s, 0, mu) and L = (x, y, z)."""
    hx, hz = x + np.sqrt(1 - mu * mu), z + mu
    facing = hz / np.sqrt(hx * hx + y * y + hz * hz)
    square, up = alpha * alpha, np.maximum(z, 1e-9)
    distribution = square / (np.pi * (1 - facing * facing * (1 - square)) ** 2)
    shadow = up * np.sqrt(square + (1 - square) * mu * mu) + mu * np.sqrt(square + (1 - square) * up * up)
    return np.where(z > 0, distribution * up * 0.5 / shadow, 0)


def cosine(m, x, y, z):
    """Returns the density of a clamped cosine that the inverse matrix m0 0 m1, 0 1 0, m2 0 m3 transforms."""
    along, up = m[0] * x + m[1] * z, m[2] * x + m[3] * z
    return np.maximum(up, 0) * abs(m[0] * m[3] - m[1] * m[2]) / (np.pi * (along * along + y * y + up * up) ** 2)


def differences(m, directions, p, weight):
    q = cosine(m, *directions)
    return np.sqrt(weight / (p + q)) * (p - q)


def slopes(m, *target):
    """Returns the derivatives of the differences with respect to the four numbers of the matrix."""
    steps = 1e-5 * np.eye(4)
    return np.stack([differences(m + h, *target) - differences(m - h, *target) for h in steps], 1) / 2e-5


def fit_cosine(m, *target):
    """Finds the matrix with the least sum of squared differences, by Levenberg-Marquardt steps from m. Returns the sum
    and the matrix."""
    m, damping = np.array(m, float), 1e-3
    now = differences(m, *target)
    for _ in range(60):
        slope = slopes(m, *target)
        normal, down = slope.T @ slope, slope.T @ now
        before = now @ now
        for _ in range(8):
            trial = m - np.linalg.solve(normal + damping * np.diag(np.diag(normal)) + 1e-12 * np.eye(4), down)
            then = differences(trial, *target)
            if then @ then < before and trial[0] > 0 and trial[3] > 0: break
            damping *= 5
        else: break
        m, now, damping = trial, then, max(damping / 5, 1e-9)
        if before - now @ now < 1e-9 * before: break
    return now @ now, m


def cosine_target(mu, roughness):
    """Returns directions, the lobe in these directions with the integral 1, and the solid angles for which they
    stand."""
    x, y, z, _, weight = [v.ravel() for v in lobe_directions([mu], roughness * roughness, 64, 40)]
    keep = weight > 0
    x, y, z, weight = x[keep], y[keep], z[keep], weight[keep]
    p = lobe(x, y, z, mu, roughness * roughness)
    return (x, y, z), p / weight.sum(), weight / p


def scale(mu):
    """Returns the factors that turn an entry of the table into the numbers of the matrix."""
    side = np.sqrt(1 - mu * mu)
    return np.array([1, side, -side, 1])


def fit_cosines():
    """Fits the table, beginning with the roughest row and the normal direction. Each fit starts from its neighbours,
    and from the lobe of a nearly smooth surface."""
    table = np.zeros((SIZE, SIZE, 4))
    for row in range(SIZE - 1, -1, -1):
        roughness = SMOOTHEST + (ROUGHEST - SMOOTHEST) * row / (SIZE - 1)
        for column in range(SIZE - 1, -1, -1):
            mu = min(max((column / (SIZE - 1)) ** 2, 0.002), 0.9999)
            wide, side = min(1, 2 * roughness * roughness), np.sqrt(1 - mu * mu)
            starts = [np.array([mu * mu, side * mu, -0.6 * side * wide * mu, mu * wide])]
            if column < SIZE - 1: starts.append(table[row, column + 1] * scale(mu))
            if row < SIZE - 1: starts.append(table[row + 1, column] * scale(mu))
            target = cosine_target(mu, roughness)
            best = min((fit_cosine(m, *target) for m in starts), key=lambda fit: fit[0])[1]
            table[row, column] = best / scale(mu)
    return np.round(np.clip(table, 0, 65535 / 32768) * 32768) / 32768


def form_factor(corners):
    """Returns the share of a clamped cosine that the part of a polygon above z = 0 receives."""
    kept = []
    for a, b in zip(corners, np.roll(corners, -1, 0)):
        if a[2] > 0: kept.append(a)
        if (a[2] > 0) != (b[2] > 0): kept.append(a + (b - a) * a[2] / (a[2] - b[2]))
    if len(kept) < 3: return 0.0
    unit = np.array(kept) / np.linalg.norm(kept, axis=1)[:, None]
    following = np.roll(unit, -1, 0)
    normal = np.cross(unit, following)
    sine = np.linalg.norm(normal, axis=1)
    angle = np.arctan2(sine, (unit * following).sum(1))
    ratio = np.where(sine > 1e-12, angle / np.maximum(sine, 1e-12), 1)
    return abs((normal[:, 2] * ratio).sum()) / (2 * np.pi)


def random_polygon(random, mu, alpha, toward_lobe, corners):
    """Returns a random quadrilateral or triangle (whose last two corners coincide) above the horizon."""
    while True:
        centre = random.normal(size=3)
        centre = centre / np.linalg.norm(centre) * [1, 1, np.sign(centre[2])]
        if toward_lobe:
            half = np.append(alpha * random.normal(size=2), 1)
            half /= np.linalg.norm(half)
            view = np.array([np.sqrt(1 - mu * mu), 0, mu])
            centre = 2 * (view @ half) * half - view
        normal = random.normal(size=3) + 2 * centre
        normal /= np.linalg.norm(normal)
        u = np.cross(normal, random.normal(size=3))
        u *= np.exp(random.uniform(np.log(0.05), 0)) / np.linalg.norm(u)
        v = np.cross(normal, u) * random.uniform(0.4, 1)
        polygon = np.array([centre - u - v, centre + u - v, centre + u + v, centre - u + v])
        if corners == 3: polygon[3] = polygon[2]
        if polygon[:, 2].min() > 0.01 and centre @ normal > 0.2: return polygon


def over_polygon(polygon, mu, alpha, count=48):
    """Returns the integral of D Vis cos over the directions of a polygon."""
    points, weights = gauss(count)
    s, t = points[:, None, None], points[None, :, None]
    a, b, c, d = polygon
    place = (1 - s) * (1 - t) * a + s * (1 - t) * b + s * t * c + (1 - s) * t * d
    along_s, along_t = (1 - t) * (b - a) + t * (c - d), (1 - s) * (d - a) + s * (c - b)
    square = (place * place).sum(2)
    solid = abs((place * np.cross(along_s, along_t)).sum(2)) / square ** 1.5
    x, y, z = np.moveaxis(place / np.sqrt(square)[..., None], 2, 0)
    return weights @ (lobe(x, y, z, mu, alpha) * solid) @ weights


def report_cosines(table):
    random = np.random.default_rng(7)
    for roughness in (0.25, 0.3, 0.4, 0.5, 0.6, 0.7, 0.85, 1):
        errors = {"all": [], "mu >= 0.2": []}
        for trial in range(800):
            mu = random.uniform(0.02, 1)
            polygon = random_polygon(random, mu, roughness ** 2, trial % 2, 3 + trial // 2 % 2)
            weights = bilinear(np.array([np.sqrt(mu)]), np.array([roughness_axis(roughness)]))
            m = (weights @ table.reshape(-1, 4))[0] * scale(mu)
            inverse = np.array([[m[0], 0, m[1]], [0, 1, 0], [m[2], 0, m[3]]])
            true = over_polygon(polygon, mu, roughness ** 2) / albedo([mu], roughness, 64, 40)[0][0]
            error = abs(form_factor(polygon @ inverse.T) - true)
            errors["all"].append(error)
            if mu >= 0.2: errors["mu >= 0.2"].append(error)
        print("roughness %.2f: error of polygons relative to the lobe" % roughness, "; ".join(
            "%s: rms %.4f, 99 %% below %.4f" % (name, np.sqrt(np.mean(np.square(e))), np.quantile(e, 0.99))
            for name, e in errors.items()), file=sys.stderr)


def print_table(name, note, table, unit):
    """Returns a C array with a row of braces for each row of the table and 16 numbers per line."""
    numbers = np.rint(table.reshape(SIZE, -1) * unit).astype(int)
    print("/* %s */" % note)
    print("static const unsigned short %s[%d][%d] = {" % (name, SIZE, numbers.shape[1]))
    for row in numbers:
        lines = [", ".join("%d" % v for v in row[i:i + 16]) for i in range(0, len(row), 16)]
        print("    { " + ",\n      ".join(lines) + " },")
    print("};")


def main():
    e_table, b_table = fit_albedo()
    matrices = fit_cosines()
    print("/* matte share: %.5f + u (%.5f + u (%.5f + u %.5f)), u = 1 - mu */" % tuple(fit_matte_share()))
    for name, column in zip("Eb", sphere_means().T):
        print("/* mean of %s over a sphere, for each row:\n   %s */" % (name, " ".join("%.4f" % v for v in column)))
    print_table("lobe_albedo", "rows: roughness; columns: mu (1 + alpha) / (mu + alpha). "
                "E and b / (1 - mu)^5, in 1 / 65535", np.stack([e_table, b_table], 1), 65535)
    print_table("lobe_cosines", "rows: roughness; columns: sqrt(mu). m0, m1, m2, m3, in 1 / 32768", matrices, 32768)
    if "--quick" in sys.argv[1:]: return
    report_albedo(e_table, b_table)
    report_cosines(matrices)


if __name__ == "__main__":
    main()
