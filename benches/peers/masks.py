"""From masks to tetrahedra side by side with gmsh (Netgen's optimiser) and TetGen, on one core.

    cargo build --release
    python3 benches/peers/masks.py [target/release/cardiotwin]

Makes a throw-away virtual environment. The masks are the wall and the blood of a truncated ellipsoidal left ventricle on cubic voxels of 1.5 mm;
the edge asked for is 3 mm. The peers get the smoothed iso-surface of the wall's mask, remeshed to triangles of that edge by pyacvd, as is usual; we
get the label map. Every side is charged its own processor seconds from the mask in memory (ours: from the file) to the mesh; the surface error is
that of the mesh's boundary vertices from the exact ellipsoids, away from the base by 3 mm.
"""

import json
import os
import pathlib
import resource
import subprocess
import sys
import tempfile
import time
import venv

PACKAGES = ["numpy", "scipy", "nibabel", "pyvista", "pyacvd", "gmsh", "tetgen"]
VOXEL_MM, EDGE_MM = 1.5, 3.0
CAVITY_MM, EPICARDIUM_MM = (24.0, 60.0), (34.0, 68.0)
BASE_MM = 20.25


def in_environment_of_its_own():
    with tempfile.TemporaryDirectory() as folder:
        venv.create(folder, with_pip=True)
        python = str(pathlib.Path(folder, "bin", "python"))
        subprocess.run([python, "-m", "pip", "install", "--quiet", *PACKAGES], check=True)
        environment = {**os.environ, "OMP_NUM_THREADS": "1", "RAYON_NUM_THREADS": "1", "PYVISTA_OFF_SCREEN": "true"}
        return subprocess.run([python, __file__, "--measure", *sys.argv[1:]], env=environment).returncode


def level(points, semi_axes):
    import numpy as np

    short, long = semi_axes
    return np.sqrt((points[..., 0] ** 2 + points[..., 1] ** 2) / short**2 + points[..., 2] ** 2 / long**2) - 1.0


def exact_wall_ml():
    import math

    def below(semi_axes):
        (short, long), t = semi_axes, BASE_MM / semi_axes[1]
        return math.pi * short**2 * long * (t - t**3 / 3 + 2 / 3) / 1000

    return below(EPICARDIUM_MM) - below(CAVITY_MM)


def drawn():
    """The label map (1 blood, 2 wall) and the world position of its first voxel."""
    import numpy as np

    origin = np.array([-42.0, -42.0, -78.0])
    count = [57, 57, int((BASE_MM + 12.0 - origin[2]) / VOXEL_MM) + 1]
    axes = [origin[a] + VOXEL_MM * np.arange(count[a]) for a in range(3)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    labels = np.where(level(points, CAVITY_MM) < 0, 1, np.where(level(points, EPICARDIUM_MM) < 0, 2, 0))
    labels[points[..., 2] > BASE_MM] = 0
    return labels.astype(np.uint8), origin


def figures(points, tetrahedra):
    """Least and first percentile of the dihedral angles, least radius ratio, volume (mL), mean and 95th percentile of the surface error (mm)."""
    import numpy as np

    corners = points[tetrahedra]
    angles = []
    for i, j, k, l in [(0, 1, 2, 3), (0, 2, 1, 3), (0, 3, 1, 2), (1, 2, 0, 3), (1, 3, 0, 2), (2, 3, 0, 1)]:
        edge = corners[:, j] - corners[:, i]
        a, b = np.cross(edge, corners[:, k] - corners[:, i]), np.cross(edge, corners[:, l] - corners[:, i])
        cosine = (a * b).sum(1) / np.linalg.norm(a, axis=1) / np.linalg.norm(b, axis=1)
        angles.append(np.degrees(np.arccos(np.clip(cosine, -1, 1))))
    u, v, w = (corners[:, n] - corners[:, 0] for n in (1, 2, 3))
    six = np.abs((u * np.cross(v, w)).sum(1))
    area = sum(
        np.linalg.norm(np.cross(corners[:, b] - corners[:, a], corners[:, c] - corners[:, a]), axis=1) / 2
        for a, b, c in [(0, 1, 2), (0, 1, 3), (0, 2, 3), (1, 2, 3)]
    )
    square = lambda x: (x**2).sum(1, keepdims=True)
    circumscribed = np.linalg.norm(square(u) * np.cross(v, w) + square(v) * np.cross(w, u) + square(w) * np.cross(u, v), axis=1) / (2 * six)
    ratio = 3 * (six / 2 / area) / circumscribed
    faces = np.sort(np.concatenate([tetrahedra[:, f] for f in ([0, 1, 2], [0, 1, 3], [0, 2, 3], [1, 2, 3])]), axis=1)
    unique, counts = np.unique(faces, axis=0, return_counts=True)
    boundary = points[np.unique(unique[counts == 1])]
    boundary = boundary[boundary[:, 2] < BASE_MM - 3.0]

    def distance(semi_axes):
        scaled = boundary / np.array([semi_axes[0], semi_axes[0], semi_axes[1]])
        k = np.linalg.norm(scaled, axis=1)
        slope = np.linalg.norm(scaled / np.array([semi_axes[0], semi_axes[0], semi_axes[1]]), axis=1)
        return np.abs(k * (k - 1) / slope)

    error = np.minimum(distance(CAVITY_MM), distance(EPICARDIUM_MM))
    angles = np.concatenate(angles)
    return len(tetrahedra), angles.min(), np.percentile(angles, 1), ratio.min(), six.sum() / 6000, error.mean(), np.percentile(error, 95)


def surface(labels, origin):
    import numpy as np
    import pyacvd
    import pyvista
    from scipy.ndimage import gaussian_filter

    wall = gaussian_filter((labels == 2).astype(float), 1.0)
    grid = pyvista.ImageData(dimensions=wall.shape, spacing=(VOXEL_MM,) * 3, origin=origin)
    grid["wall"] = wall.ravel(order="F")
    contour = grid.contour([0.5], scalars="wall").triangulate().clean()
    clusters = pyacvd.Clustering(contour)
    clusters.subdivide(2)
    clusters.cluster(int(contour.area / (EDGE_MM**2 * np.sqrt(3) / 2)))
    return clusters.create_mesh().clean()


def by_gmsh(labels, origin, folder):
    import gmsh
    import numpy as np

    path = str(pathlib.Path(folder, "wall.stl"))
    surface(labels, origin).save(path)
    gmsh.initialize(["gmsh", "-v", "1", "-nt", "1"])
    gmsh.merge(path)
    gmsh.model.mesh.removeDuplicateNodes()
    gmsh.model.geo.addVolume([gmsh.model.geo.addSurfaceLoop([tag for _, tag in gmsh.model.getEntities(2)])])
    gmsh.model.geo.synchronize()
    gmsh.option.setNumber("Mesh.MeshSizeMax", EDGE_MM)
    gmsh.model.mesh.generate(3)
    gmsh.model.mesh.optimize("Netgen")
    tags, coordinates, _ = gmsh.model.mesh.getNodes()
    place = np.zeros(int(tags.max()) + 1, dtype=int)
    place[tags.astype(int)] = np.arange(len(tags))
    _, nodes = gmsh.model.mesh.getElementsByType(4)
    gmsh.finalize()
    return coordinates.reshape(-1, 3), place[nodes.astype(int)].reshape(-1, 4)


def by_tetgen(labels, origin, folder):
    import tetgen

    mesher = tetgen.TetGen(surface(labels, origin))
    result = mesher.tetrahedralize(order=1, mindihedral=15, minratio=1.4, maxvolume=EDGE_MM**3 / 8.5)
    return result[0], result[1]


def by_us(binary, labels, origin, folder):
    import nibabel
    import numpy as np
    import pyvista

    affine = np.diag([VOXEL_MM] * 3 + [1.0])
    affine[:3, 3] = origin
    image, mesh = pathlib.Path(folder, "labels.nii.gz"), pathlib.Path(folder, "heart.vtk")
    nibabel.save(nibabel.Nifti1Image(labels, affine), image)
    before = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
    command = [binary, "mesh", str(image), "-o", str(mesh), "--edge-length-mm", str(EDGE_MM), "--json", "-q"]
    json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
    seconds = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - before
    read = pyvista.read(mesh)
    return np.asarray(read.points, dtype=float), read.cells_dict[10], seconds


def measure():
    binary = sys.argv[2] if len(sys.argv) > 2 else "target/release/cardiotwin"
    labels, origin = drawn()
    print(f"wall of {exact_wall_ml():.2f} mL, {int((labels == 2).sum()) * VOXEL_MM**3 / 1000:.2f} mL of voxels of {VOXEL_MM} mm; edge {EDGE_MM} mm")
    print(f"{'':12}{'tetrahedra':>11}{'dihedral °':>12}{'1st pct °':>11}{'radius r.':>11}{'wall mL':>9}{'error mm':>10}{'95 %':>7}{'s':>8}")
    with tempfile.TemporaryDirectory() as folder:
        for name, mesher in [("cardiotwin", None), ("gmsh+Netgen", by_gmsh), ("TetGen", by_tetgen)]:
            if mesher is None:
                points, tetrahedra, seconds = by_us(binary, labels, origin, folder)
            else:
                start = time.process_time()
                points, tetrahedra = mesher(labels, origin, folder)
                seconds = time.process_time() - start
            count, least, percentile, ratio, volume, mean, most = figures(points, tetrahedra)
            print(f"{name:12}{count:11}{least:12.1f}{percentile:11.1f}{ratio:11.2f}{volume:9.2f}{mean:10.3f}{most:7.3f}{seconds:8.2f}")


if __name__ == "__main__":
    if "--measure" in sys.argv:
        measure()
    else:
        sys.exit(in_environment_of_its_own())
