"""What a capture of a place gives: a mesh whose vertex colours come from the photographs. NumPy only."""
import numpy as np

from pictures import codes


def captured_mesh(place, rng, error_metres):
    """Vertices and triangles of the place, with errors of the surface: normal deviates of `error_metres` per vertex.

    Parts farther from the object than twice the cameras' distance have three times longer edges. A mirror is captured as its surface."""
    vertices, faces, first = [], [], 0
    for part in place.parts:
        low, high = part.bounds()
        nearest = np.clip(place.at, low, high)
        far = np.linalg.norm(nearest - np.array(place.at)) > place.reach[1]
        v, f = part.mesh(place.step * (3 if far else 1))
        vertices.append(v)
        faces.append(f + first)
        first += len(v)
    vertices, faces = np.concatenate(vertices), np.concatenate(faces)
    return vertices + rng.normal(0, error_metres, vertices.shape), faces


def seen_colours(vertices, faces, photos, tolerance):
    """Colours (linear) of the vertices and whether a photograph sees them.

    `photos`: (picture linear (h, w, 3), planar depth (h, w), camera to world, lens). A photograph sees a vertex if its
    depth there differs by less than `tolerance` of the distance, and counts with the cosine at the surface over the
    square of the distance. Colours beyond the range of the photographs are clipped as in them.
    """
    corners = vertices[faces]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = np.zeros_like(vertices)
    for k in range(3):
        np.add.at(normals, faces[:, k], across)
    normals /= np.maximum(1e-12, np.linalg.norm(normals, axis=1, keepdims=True))
    total, weight = np.zeros((len(vertices), 3)), np.zeros(len(vertices))
    for picture, depth, matrix, lens in photos:
        matrix = np.array(matrix)
        local = (vertices - matrix[:3, 3]) @ matrix[:3, :3]
        z = -local[:, 2]
        front = z > 1e-3
        x = np.where(front, lens["cx"] + lens["fl_x"] * local[:, 0] / np.where(front, z, 1), -1)
        y = np.where(front, lens["cy"] - lens["fl_y"] * local[:, 1] / np.where(front, z, 1), -1)
        front &= (x >= 0) & (y >= 0) & (x < lens["w"]) & (y < lens["h"])
        i, j = np.where(front, x, 0).astype(int), np.where(front, y, 0).astype(int)
        ray = matrix[:3, 3] - vertices
        distance = np.linalg.norm(ray, axis=1)
        cosine = (ray * normals).sum(1) / np.maximum(distance, 1e-9)
        seen = front & (cosine > 0.05) & (np.abs(depth[j, i] - z) < tolerance * z + 0.01)
        w = np.where(seen, cosine / np.maximum(distance, 0.05) ** 2, 0)
        total += w[:, None] * np.clip(picture[j, i], 0, 1)
        weight += w
    return total / np.maximum(weight, 1e-12)[:, None], weight > 0


def fill(colours, seen, faces, rounds=200):
    """Gives unseen vertices the mean colour of their coloured neighbours, ring by ring. Vertices that no ring reaches stay unseen."""
    colours, seen = colours.copy(), seen.copy()
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    edges = np.concatenate([edges, edges[:, ::-1]])
    for _ in range(rounds):
        use = edges[seen[edges[:, 0]] & ~seen[edges[:, 1]]]
        if not len(use):
            break
        total, count = np.zeros_like(colours), np.zeros(len(colours))
        np.add.at(total, use[:, 1], colours[use[:, 0]])
        np.add.at(count, use[:, 1], 1)
        new = count > 0
        colours[new] = total[new] / count[new][:, None]
        seen |= new
    return colours, seen


def write_ply(path, vertices, faces, colours):
    """Binary PLY with sRGB vertex colours of 8 bits; `colours` are linear."""
    rows = np.empty(len(vertices), [("p", "<f4", 3), ("c", "u1", 3)])
    rows["p"], rows["c"] = vertices, codes(colours)
    triangles = np.empty(len(faces), [("n", "u1"), ("v", "<i4", 3)])
    triangles["n"], triangles["v"] = 3, faces
    head = ["ply", "format binary_little_endian 1.0", f"element vertex {len(rows)}", *(f"property float {a}" for a in "xyz"),
            *(f"property uchar {c}" for c in ("red", "green", "blue")), f"element face {len(triangles)}",
            "property list uchar int vertex_indices", "end_header", ""]
    with open(path, "wb") as file:
        file.write("\n".join(head).encode() + rows.tobytes() + triangles.tobytes())


def kept(faces, seen):
    """Triangles with three coloured vertices: parts that no photograph shows are not in the mesh."""
    return faces[seen[faces].all(1)]


def compact(vertices, faces, colours):
    """Drops vertices that no triangle uses."""
    used = np.unique(faces)
    number = np.full(len(vertices), -1)
    number[used] = np.arange(len(used))
    return vertices[used], number[faces], colours[used]
