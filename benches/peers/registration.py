"""Tracking beside registration on a phantom that moves by a law in closed form: SimpleITK's demons and B-splines on the same images.

    cargo build --release
    python3 benches/peers/registration.py [target/release/cardiotwin] [--ours]

Makes a throw-away virtual environment for numpy, pandas, meshio, matplotlib and SimpleITK; `--ours` leaves registration out and keeps what it left before. Images, tracked
motion and the paths of the true vertices in it are made by our own program from `studies/15_tracking_against_registration`, in isotropic voxels and in slices of
8 mm. Every side starts from the true places at the first image and is judged by the distance of all vertices of the wall from where they truly are, in
every other image. Settings of every side were chosen on `tuning.toml`, another heart. Processor seconds are those of all threads; ours
are those of the whole run, mesh and all. Leaves `registration.csv`, `frames.csv` and `rmse.png` in the study's results.
"""

import pathlib
import resource
import subprocess
import sys
import tempfile
import time
import venv

PACKAGES = ["numpy", "pandas", "meshio", "matplotlib", "SimpleITK"]
ROOT = pathlib.Path(__file__).resolve().parents[2]
STUDY = ROOT / "studies" / "15_tracking_against_registration"
RESULTS = ROOT / "results" / "15_tracking_against_registration"
IMAGES = ["phantom", "slices"]
SPACING_MM = 2.0
# The best of what was tried on tuning.toml: demons (diffeomorphic or symmetric, smoothing 1 to 2.5 voxels, up to 320 iterations) 5.5 to 6.0 mm, B-splines of 24 mm 3.46 mm,
# of 16 mm 3.31 mm for twice the time.
DEMONS_LEVELS = [(4, 4.0, 200), (2, 2.0, 100), (1, 1.0, 20)]
DEMONS_SMOOTHING = 1.0
B_SPLINE_NET_MM = 24.0
CARRIED = ['tracking.base_projection="full"', 'tracking.block_shape="carried"']
INSIDE = [*CARRIED, "tracking.block_window=1.5", 'tracking.wall="block_matching"', "tracking.wall_gain_kpa_per_mm2=5", "tracking.block_size_mm=10.5"]
# Our runs: name, settings beside those of track.toml, and whether personalise.toml finds the heart's parameters first.
OURS = [
    ("tracking, as it comes", [], False),
    ("tracking, blocks in the wall", INSIDE, False),
    ("the same, personalised", INSIDE, True),
]


def in_environment_of_its_own():
    with tempfile.TemporaryDirectory() as folder:
        venv.create(folder, with_pip=True)
        python = str(pathlib.Path(folder, "bin", "python"))
        subprocess.run([python, "-m", "pip", "install", "--quiet", *PACKAGES], check=True)
        return subprocess.run([python, __file__, "--measure", *sys.argv[1:]]).returncode


def run_ours(binary, *words):
    """Processor seconds of a run of our program."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run([binary, *map(str, words)], check=True, stdout=subprocess.DEVNULL)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def measure():
    import pandas

    words = [word for word in sys.argv[1:] if not word.startswith("--")]
    binary = str(pathlib.Path(words[0] if words else ROOT / "target" / "release" / "cardiotwin").resolve())
    frames = []
    if "--ours" in sys.argv:
        kept = pandas.read_csv(RESULTS / "frames.csv")
        frames = kept[kept["method"].isin(["demons", "B-spline"])].to_dict("records")
    for images in IMAGES:
        run_ours(binary, "run", STUDY / f"{images}.toml", "-q", "--set", "output.figures=false")
        truth = positions(RESULTS / images / "heart")
        frames += rows(images, "no motion", truth, [truth[0]] * len(truth), 0.0)
        for name, settings, is_personalised in OURS:
            frames += rows(images, name, truth, *tracked(binary, images, settings, is_personalised, truth))
        if "--ours" not in sys.argv:
            frames += registered(images, truth)
    frames = pandas.DataFrame(frames)
    frames.to_csv(RESULTS / "frames.csv", index=False)
    table = frames.groupby(["images", "method"], sort=False).agg(
        rmse_mean_mm=("rmse_mm", "mean"), rmse_greatest_mm=("rmse_mm", "max"), processor_s_per_frame=("processor_s", "mean")
    )
    print(table.round(2).to_string())
    table.round(3).to_csv(RESULTS / "registration.csv")
    draw(frames, RESULTS / "rmse.png")


def positions(folder):
    import meshio

    files = sorted(folder.glob("*.vtu"))
    # The last mesh of a beat is its first frame again.
    return [meshio.read(file).points for file in files[:-1]]


def rows(images, method, truth, found, seconds):
    """One row a frame after the first: all components, and along the axis, around it and away from it."""
    import numpy

    each = []
    for frame in range(1, len(truth)):
        error = found[frame] - truth[frame]
        outward = (truth[frame] - truth[frame].mean(axis=0)) * [1.0, 1.0, 0.0]
        outward /= numpy.linalg.norm(outward, axis=1)[:, None]
        around = numpy.cross([0.0, 0.0, 1.0], outward)
        parts = {"radial": (error * outward).sum(axis=1), "around": (error * around).sum(axis=1), "along": error[:, 2]}
        each.append({
            "images": images,
            "method": method,
            "frame": frame,
            "rmse_mm": round(rms(numpy.linalg.norm(error, axis=1)), 3),
            **{f"rmse_{part}_mm": round(rms(values), 3) for part, values in parts.items()},
            "processor_s": round(seconds / (len(truth) - 1), 3),
        })
    print(f"{images}, {method}: {numpy.mean([row['rmse_mm'] for row in each]):.2f} mm, {each[0]['processor_s']} s a frame", flush=True)
    return each


def rms(values):
    return float((values**2).mean() ** 0.5)


def tracked(binary, images, settings, is_personalised, truth):
    """Where the true vertices are followed to, and processor seconds."""
    import pandas

    with tempfile.TemporaryDirectory() as folder:
        where = ["--data", RESULTS / images, "-q", "--set", "output.figures=false"]
        settings = [word for setting in settings for word in ("--set", setting)]
        seconds = 0.0
        if is_personalised:
            seconds += run_ours(binary, "run", STUDY / "personalise.toml", "-o", folder + "/found", *where, *settings)
            settings += ["--set", f'parameters_from="{folder}/found/parameters.csv"']
        seconds += run_ours(binary, "run", STUDY / "track.toml", "-o", folder + "/tracked", *where, *settings)
        points = pandas.DataFrame(truth[0], columns=["x_mm", "y_mm", "z_mm"])
        points.insert(0, "point", [f"v{n}" for n in range(len(points))])
        points.to_csv(folder + "/points.csv", index=False)
        subprocess.run([binary, "follow", folder + "/tracked", "--points", folder + "/points.csv"], check=True, capture_output=True)
        paths = pandas.read_csv(folder + "/tracked/paths.csv").drop_duplicates(["point", "frame"])
    paths["order"] = paths["point"].str[1:].astype(int)
    found = {frame: part.sort_values("order")[["x_mm", "y_mm", "z_mm"]].to_numpy() for frame, part in paths.groupby("frame")}
    return [found[frame] for frame in range(len(truth))], seconds


def registered(images, truth):
    import numpy
    import SimpleITK as sitk

    frames = read_frames(sitk, RESULTS / images / "cine.nii.gz")
    to_lps = numpy.array([-1.0, -1.0, 1.0])
    each = []
    for name, register in [("demons", demons), ("B-spline", b_spline)]:
        found, last, start = [truth[0]], None, time.process_time()
        for frame in range(1, len(frames)):
            last = register(sitk, frames[0], frames[frame], last)
            found.append(numpy.array([last.TransformPoint(p) for p in (truth[0] * to_lps).tolist()]) * to_lps)
        each += rows(images, name, truth, found, time.process_time() - start)
    return each


def read_frames(sitk, file):
    """Frames on isotropic voxels, as is usual before three-dimensional registration."""
    cine = sitk.ReadImage(str(file), sitk.sitkFloat32)
    size = list(cine.GetSize())
    frames = []
    for frame in range(size[3]):
        image = sitk.Extract(cine, size[:3] + [0], [0, 0, 0, frame])
        shape = [int((n - 1) * s / SPACING_MM + 1e-6) + 1 for n, s in zip(image.GetSize(), image.GetSpacing())]
        frames.append(sitk.Resample(image, shape, sitk.Transform(), sitk.sitkLinear, image.GetOrigin(), [SPACING_MM] * 3, image.GetDirection()))
    return frames


def demons(sitk, fixed, moving, last):
    """Fast symmetric demons, coarse to fine, started from the last frame's field."""
    identity = sitk.Transform(3, sitk.sitkIdentity)
    shape = (fixed.GetSize(), fixed.GetOrigin(), fixed.GetSpacing(), fixed.GetDirection())
    field = sitk.TransformToDisplacementField(last or identity, sitk.sitkVectorFloat64, *shape)
    for shrink, smooth_mm, iterations in DEMONS_LEVELS:
        level = [sitk.Shrink(sitk.SmoothingRecursiveGaussian(i, smooth_mm) if smooth_mm else i, [shrink] * 3) for i in (fixed, moving)]
        demons = sitk.FastSymmetricForcesDemonsRegistrationFilter()
        demons.SetNumberOfIterations(iterations)
        demons.SetStandardDeviations(DEMONS_SMOOTHING)
        field = sitk.Resample(demons.Execute(level[0], level[1], sitk.Resample(field, level[0])), fixed)
    return sitk.DisplacementFieldTransform(sitk.Cast(field, sitk.sitkVectorFloat64))


def b_spline(sitk, fixed, moving, last):
    """Free-form deformation, mean squares on a tenth of the voxels, coarse to fine, started from the last frame's."""
    net = [max(1, round(n * SPACING_MM / B_SPLINE_NET_MM)) for n in fixed.GetSize()]
    start = sitk.BSplineTransform(last) if last else sitk.BSplineTransformInitializer(fixed, net)
    method = sitk.ImageRegistrationMethod()
    method.SetMetricAsMeanSquares()
    method.SetMetricSamplingStrategy(method.RANDOM)
    method.SetMetricSamplingPercentage(0.1, 1)
    method.SetInterpolator(sitk.sitkLinear)
    method.SetOptimizerAsLBFGSB(gradientConvergenceTolerance=1e-5, numberOfIterations=20)
    method.SetShrinkFactorsPerLevel([2, 1])
    method.SetSmoothingSigmasPerLevel([2.0, 0.0])
    method.SetSmoothingSigmasAreSpecifiedInPhysicalUnits(True)
    method.SetInitialTransform(start, inPlace=True)
    return sitk.BSplineTransform(method.Execute(fixed, moving))


def draw(frames, file):
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plot

    figure, panels = plot.subplots(1, len(IMAGES), figsize=(11, 4), sharey=True)
    for axes, images in zip(panels, IMAGES):
        for name, part in frames[frames["images"] == images].groupby("method", sort=False):
            axes.plot(part["frame"], part["rmse_mm"], "o-", label=name, markersize=3)
        axes.set(xlabel="image", title={"phantom": "voxels of 2 mm", "slices": "slices of 8 mm"}[images])
        axes.grid(alpha=0.3)
    panels[0].set_ylabel("RMSE of the vertices of the wall (mm)")
    panels[1].legend(fontsize=8)
    figure.tight_layout()
    figure.savefig(file, dpi=110)


if __name__ == "__main__":
    sys.exit(measure() if "--measure" in sys.argv else in_environment_of_its_own())
