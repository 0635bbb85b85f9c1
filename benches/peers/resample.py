"""Isotropic resampling and sampling at points side by side with SimpleITK and scipy, on one core.

    python3 benches/peers/resample.py

Makes a throw-away virtual environment for numpy, scipy and SimpleITK. Our side is `cargo bench --bench image`, which obeys this script: both sides
take turns on the same image and points, each is charged its own processor seconds as Linux counts them, their answers are compared, and what is
printed are the medians and the median of the rounds' ratios (ours to theirs; below 1 we are faster).
"""

import os
import pathlib
import subprocess
import sys
import tempfile
import venv

from servant import ONE_THREAD, Servant

PACKAGES = ["numpy", "scipy", "SimpleITK"]
SHAPE, SPACING_MM, ROUNDS = (192, 192, 12), (1.5, 1.5, 8.0), 21


def in_environment_of_its_own():
    with tempfile.TemporaryDirectory() as folder:
        venv.create(folder, with_pip=True)
        python = str(pathlib.Path(folder, "bin", "python"))
        subprocess.run([python, "-m", "pip", "install", "--quiet", *PACKAGES], check=True)
        return subprocess.run([python, __file__, "--measure"], env={**os.environ, **ONE_THREAD}).returncode


def measure():
    import statistics
    import time

    import numpy
    import SimpleITK
    from scipy.ndimage import map_coordinates

    SimpleITK.ProcessObject.SetGlobalDefaultNumberOfThreads(1)

    def theirs(action):
        # All threads of the process, as SimpleITK works in a pool of its own.
        before = time.process_time()
        action()
        return time.process_time() - before

    def row(what, peer, pairs):
        ours, peers = (statistics.median(side) for side in zip(*pairs))
        ratio = statistics.median(a / b for a, b in pairs)
        print(f"{what:28} ours {1e3 * ours:8.2f} ms   {peer} {1e3 * peers:8.2f} ms   ratio {ratio:.2f}", flush=True)

    servant = Servant("image")
    with tempfile.TemporaryDirectory() as folder:
        file = str(pathlib.Path(folder, "image"))
        servant.seconds(f"image {file}")
        voxels = numpy.fromfile(file, "<f4").reshape(SHAPE[::-1])
        points = numpy.fromfile(file + ".points", "<f8").reshape(-1, 3)
        image = SimpleITK.GetImageFromArray(voxels)
        image.SetSpacing(SPACING_MM)
        size = [int((n - 1) * s / min(SPACING_MM) + 1e-6) + 1 for n, s in zip(SHAPE, SPACING_MM)]
        resampler = SimpleITK.ResampleImageFilter()
        resampler.SetInterpolator(SimpleITK.sitkLinear)
        resampler.SetSize(size)
        resampler.SetOutputSpacing([min(SPACING_MM)] * 3)
        resampler.SetOutputPixelType(SimpleITK.sitkFloat32)
        place = points[:, ::-1].T.copy()

        servant.seconds("resample"), servant.seconds("sample")
        servant.seconds(f"leave {file}.ours")
        ours = numpy.fromfile(f"{file}.ours", "<f4").reshape(size[::-1])
        peer = SimpleITK.GetArrayFromImage(resampler.Execute(image))
        print(f"resampled to {size}; greatest difference {abs(ours - peer)[:-1, :-1, :-1].max():.1e}")
        values = numpy.fromfile(f"{file}.ours.values", "<f8")
        print(f"{len(values)} points; greatest difference {abs(values - map_coordinates(voxels.astype(float), place, order=1)).max():.1e}")
        row("resample", "SimpleITK", [(servant.seconds("resample"), theirs(lambda: resampler.Execute(image))) for _ in range(ROUNDS)])
        wide = voxels.astype(float)
        row("sample at points", "scipy", [(servant.seconds("sample"), theirs(lambda: map_coordinates(wide, place, order=1))) for _ in range(ROUNDS)])


if __name__ == "__main__":
    sys.exit(measure() if "--measure" in sys.argv else in_environment_of_its_own())
