"""The plain twins of matching/_kernels.py: residuals by pose, derivatives by differences, all poses tried."""

import math

import numpy as np

COHERENT, CLUTTER_WEIGHT, OTHER_SIDE, ONE_SIDED = 0.6, 0.3, -0.3, 0.8


def moved(pose, points):
    """Points and their normals, rows (x, y, nx, ny), at a pose."""
    turn = np.array([[math.cos(pose[2]), -math.sin(pose[2])], [math.sin(pose[2]), math.cos(pose[2])]])
    return np.hstack((points[:, :2] @ turn.T + np.asarray(pose)[:2], points[:, 2:4] @ turn.T))


def is_other_side(surface, normal):
    """Whether a surface that was seen from one side only is looked at from the other."""
    flat = surface[2] ** 2 + surface[3] ** 2 > COHERENT
    return flat and surface[4] > ONE_SIDED and surface[2] * normal[0] + surface[3] * normal[1] < OTHER_SIDE


def associations(contents, points, pose, cell_size_m, gate_m):
    """(row of the point, its surface) of all points that find one within ``gate_m``."""
    pairs = []
    for k, (x, y, nx, ny) in enumerate(moved(pose, points)):
        source = contents.nearest.get((math.floor(y / cell_size_m), math.floor(x / cell_size_m)))
        if source is None:
            continue
        surface = contents.mean[source]
        if math.hypot(x - surface[0], y - surface[1]) <= gate_m and not is_other_side(surface, (nx, ny)):
            pairs.append((k, surface))
    return pairs


def residuals(pairs, points, pose):
    """A vector a pair: the distance along the surface's normal, or in x and y where it has none.

    On a surface without a normal only the points of thin things, posts and legs, have any.
    """
    there = moved(pose, points)
    result = []
    for k, surface in pairs:
        d, n = there[k, :2] - surface[:2], np.array(surface[2:4])
        if n @ n > COHERENT:
            result.append(np.array([d @ n / np.linalg.norm(n)]))
        elif points[k, 4]:
            result.append(d)
    return result


def robust_cost(pairs, points, pose, half_m):
    """The sum of Cauchy's losses ``half^2 / 2 * log(1 + e^2 / half^2)``; pairs without a normal count for less."""
    return sum(
        (1.0 if len(e) == 1 else CLUTTER_WEIGHT) * half_m**2 / 2.0 * math.log(1.0 + e @ e / half_m**2)
        for e in residuals(pairs, points, pose)
    )


def gradient(function, pose, step=1e-6):
    """The derivative of a function of a pose by central differences; a list of vectors for a list of vectors."""
    sides = [(function(pose + d), function(pose - d)) for d in step * np.eye(3)]
    if isinstance(sides[0][0], list):
        return [
            np.column_stack([(plus[k] - minus[k]) / (2 * step) for plus, minus in sides])
            for k in range(len(sides[0][0]))
        ]
    return np.array([(plus - minus) / (2.0 * step) for plus, minus in sides])


def normal_matrix(pairs, points, pose, half_m):
    """``sum w J^T J`` with the weights of the Cauchy loss."""
    H = np.zeros((3, 3))
    jacobians = gradient(lambda p: residuals(pairs, points, p), np.asarray(pose, dtype=float))
    for e, J in zip(residuals(pairs, points, pose), jacobians, strict=True):
        H += (1.0 if len(e) == 1 else CLUTTER_WEIGHT) / (1.0 + e @ e / half_m**2) * J.T @ J
    return H


def judged(contents, seen_tiles, points, pose, settings):
    """Points matched, contradicted, never seen; ``settings`` = (cell size, reach of a match, reach of doubt)."""
    size, reach, doubt = settings
    matched = contradicted = unseen = 0
    for x, y, nx, ny in moved(pose, points):
        cell = (math.floor(y / size), math.floor(x / size))
        surface = contents.mean.get(contents.nearest.get(cell))
        distance = math.inf
        if surface is not None and not is_other_side(surface, (nx, ny)):
            distance = math.hypot(x - surface[0], y - surface[1])
        if distance < reach:
            matched += 1
        elif distance > doubt:
            if contents.evidence.get(cell, 0) == 0:
                unseen += 1
            else:
                contradicted += 1
        elif (cell[0] // 32, cell[1] // 32) not in seen_tiles:
            unseen += 1
    return matched, contradicted, unseen


def all_scores(finest, points, search):
    """The score of every whole-cell offset in the radius and every angle, by (dx, dy, theta).

    ``search``: centre, thetas, prior_theta, radius and tie_radius (cells), tie_turn (rad), tie_weight, cell_size_m.
    """
    radius = search["radius"]
    steps = range(-math.ceil(radius), math.ceil(radius) + 1)
    scores = {}
    for theta in search["thetas"]:
        at = moved((0.0, 0.0, theta), np.hstack((points[:, :2], points[:, :2])))[:, :2] / search["cell_size_m"]
        cells = np.floor(at + search["centre"]).astype(int)
        for dx in steps:
            for dy in steps:
                if dx**2 + dy**2 > radius**2:
                    continue
                c, r = cells[:, 0] + dx, cells[:, 1] + dy
                inside = (c >= 0) & (r >= 0) & (c < finest.shape[1]) & (r < finest.shape[0])
                mean = finest[r[inside], c[inside]].astype(int).sum() / (255.0 * len(points))
                tie = (dx**2 + dy**2) / search["tie_radius"] ** 2
                tie += ((theta - search["prior_theta"]) / search["tie_turn"]) ** 2
                scores[dx, dy, float(theta)] = mean - search["tie_weight"] * min(tie, 1.0)
    return scores


def surfaces(contents, points, pose, settings):
    """The surfaces of a scan: a list each of (row of the point, place, normal, rows (distance, weight, Jacobian)).

    ``settings`` = (cell size, reach, half-weight distance). A post makes two surfaces, one for each axis.
    """
    size, reach, half = settings
    there, found, last = moved(pose, points), [], None
    for k, surface in associations(contents, points, pose, size, reach):
        place, away = there[k, :2], there[k, :2] - surface[:2]
        lever = np.array([-(place[1] - pose[1]), place[0] - pose[0]])
        normal = np.array(surface[2:4])
        if normal @ normal <= COHERENT:
            if points[k, 4]:
                weight = CLUTTER_WEIGHT / (1.0 + away @ away / half**2)
                found += [[(k, place, None, away[i], weight, np.array([*np.eye(2)[i], lever[i]]))] for i in (0, 1)]
                last = None
            continue
        normal /= np.linalg.norm(normal)
        e = normal @ away
        row = (k, place, normal, e, 1.0 / (1.0 + e**2 / half**2), np.array([*normal, normal @ lever]))
        continues = (
            last is not None
            and np.linalg.norm(place - last[-1][1]) <= 0.3
            and np.linalg.norm(place - last[0][1]) <= 1.0
            and normal @ last[-1][2] >= 0.85
        )
        if not continues:
            last = []
            found.append(last)
        last.append(row)
    return found


def surface_sums(found, cell_size_m):
    """What `sum_surfaces` writes, from `surfaces`, in its order."""
    rows = [row for surface in found for row in surface]
    normal, shared = np.zeros((3, 3)), np.zeros((3, 3))
    for *_, w, J in rows:
        normal += w * np.outer(J, J)
    within = freedom = between = expected = returns = count = 0.0
    for surface in found:
        e, w = np.array([row[3] for row in surface]), np.array([row[4] for row in surface])
        J = sum(row[4] * row[5] for row in surface)
        shared += np.outer(J, J)
        mean = np.average(e, weights=w)
        within += np.sum(w * (e - mean) ** 2)
        freedom += w.sum() - np.sum(w**2) / w.sum()
        between += w.sum() * mean**2
        expected += np.sum(w**2) / w.sum()
        if len(surface) > 1:
            spacing = max(np.linalg.norm(surface[-1][1] - surface[0][1]), cell_size_m) / (len(surface) - 1)
            returns, count = returns + len(surface) * cell_size_m / spacing, count + len(surface)
    upper = np.triu_indices(3)
    weight = sum(row[4] for row in rows)
    return np.array(
        [*normal[upper], *shared[upper], within, freedom, between, expected, weight, len(found), returns, count]
    )


def deviations(found):
    """How far points on flat surfaces lie off the middle of the points beside them, if all three normals are alike."""
    flat = sorted((row for surface in found for row in surface if row[2] is not None), key=lambda row: row[0])
    triples = zip(flat, flat[1:], flat[2:], strict=False)
    return np.array(
        [
            abs(n1 @ (p1 - 0.5 * (p0 + p2)))
            for (k0, p0, n0, *_), (k1, p1, n1, *_), (k2, p2, n2, *_) in triples
            if k2 - k0 == 2 and n0 @ n1 > 0.85 and n2 @ n1 > 0.85
        ]
    )
