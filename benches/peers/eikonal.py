#!/usr/bin/env python3
"""Activation times beside two peers on the same box, one core: a plain heap-based label-correcting solver of the same update in C++
(plain_eikonal.cpp) and fim-python (a fast iterative method, installed from PyPI in a throw-away virtual environment).

usage: python3 benches/peers/eikonal.py [--repeats 5] [--skip-fim]     needs cargo, g++ and Python 3

Speed (processor seconds; Linux) is compared where fibres turn by 120 degrees through the box, as in a heart's wall; the error against the exact solution where the
medium is uniform (speed 600 mm/s, squared ratio 1/9, fibres oblique to the mesh, point source in a corner).
"""

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import venv
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent.parent

FIM = """
import json, sys, time
import numpy as np
from fimpy.solver import create_fim_solver
folder = sys.argv[1]
points = np.fromfile(f"{folder}/points.f64").reshape(-1, 3)
fibres = np.fromfile(f"{folder}/fibres.f64").reshape(-1, 3)
tetrahedra = np.fromfile(f"{folder}/tetrahedra.i32", dtype=np.int32).reshape(-1, 4)
speed, ratio, source = (float(word) for word in open(f"{folder}/case.txt").read().split())
metric = speed**2 * (ratio * np.eye(3) + (1 - ratio) * fibres[:, :, None] * fibres[:, None, :])
begin = time.process_time()
solver = create_fim_solver(points, tetrahedra, metric, precision=np.float64)
times = np.asarray(solver.comp_fim(np.array([int(source)]), np.array([0.0])))
print(time.process_time() - begin)
times.tofile(f"{folder}/fim.f64")
"""

ERRORS = """
import json, os, sys
import numpy as np
folder = sys.argv[1]
points = np.fromfile(f"{folder}/points.f64").reshape(-1, 3)
fibre = np.fromfile(f"{folder}/fibres.f64").reshape(-1, 3)[0]
speed, ratio, source = (float(word) for word in open(f"{folder}/case.txt").read().split())
offset = points - points[int(source)]
along = offset @ fibre
exact = np.sqrt(along**2 + ((offset**2).sum(axis=1) - along**2) / ratio) / speed
names = [name for name in ("plain", "fim", "march", "rays") if os.path.exists(f"{folder}/{name}.f64")]
times = {name: np.fromfile(f"{folder}/{name}.f64") for name in names}
print(json.dumps({
    "error_ms": {name: 1e3 * np.abs(times[name] - exact).mean() for name in names},
    "from_march_s": {name: np.abs(times[name] - times["march"]).max() for name in names if name in ("plain", "fim")},
}))
"""


def run(*command):
    environment = dict(os.environ, OMP_NUM_THREADS="1", RAYON_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")
    return subprocess.run([str(word) for word in command], check=True, env=environment, stdout=subprocess.PIPE, text=True).stdout


def main():
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--repeats", type=int, default=5)
    arguments.add_argument("--skip-fim", action="store_true", help="fim-python takes minutes")
    arguments = arguments.parse_args()
    subprocess.run(["cargo", "build", "--release", "--locked", "--example", "eikonal_case"], cwd=ROOT, check=True)
    ours = Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target")) / "release/examples/eikonal_case"
    with tempfile.TemporaryDirectory() as work:
        work = Path(work)
        plain, python = work / "plain", work / "venv/bin/python"
        run("g++", "-std=c++17", "-O3", "-o", plain, HERE / "plain_eikonal.cpp")
        venv.create(work / "venv", with_pip=True)
        run(python, "-m", "pip", "-q", "install", "fim-python==1.2.2")
        print(f"{'tetrahedra':>10} {'ours s':>8} {'no rays s':>9} {'plain s':>8} {'ours/plain':>10} {'fim s':>7} {'fim/ours':>8}")
        for cells in (32, 55):
            speed(work, ours, plain, python, cells, arguments.repeats, arguments.skip_fim or cells > 32)
        print("\nmean error against the exact point source, ms (share of the plain update's)")
        for cells in (20, 32, 55):
            accuracy(work, ours, plain, python, cells, arguments.skip_fim or cells > 20)


def speed(work, ours, plain, python, cells, repeats, skip_fim):
    """Interleaves ours and the plain solver, so that both see the same machine."""
    seconds = {"march": [], "rays": [], "plain": []}
    for _ in range(repeats):
        for line in run(ours, work, cells, 120, 1).splitlines():
            name, value = line.split()
            seconds[name].append(float(value))
        seconds["plain"].append(float(run(plain, work, 1)))
    median = {name: statistics.median(values) for name, values in seconds.items()}
    ratio = statistics.median(ours / theirs for ours, theirs in zip(seconds["rays"], seconds["plain"]))
    row = f"{6 * cells**3:10d} {median['rays']:8.3f} {median['march']:9.3f} {median['plain']:8.3f} {ratio:10.2f}"
    if not skip_fim:
        fim = float(run(python, "-c", FIM, work).splitlines()[-1])
        row += f" {fim:7.1f} {fim / median['rays']:8.0f}"
    print(row, flush=True)


def accuracy(work, ours, plain, python, cells, skip_fim):
    for name in ("plain", "fim", "march", "rays"):
        (work / f"{name}.f64").unlink(missing_ok=True)
    run(ours, work, cells, 0, 1)
    run(plain, work, 1)
    if not skip_fim:
        run(python, "-c", FIM, work)
    found = json.loads(run(python, "-c", ERRORS, work))
    error = found["error_ms"]
    row = ", ".join(f"{name} {value:.3f} ({value / error['plain']:.2f})" for name, value in error.items())
    apart = ", ".join(f"{name} {value:.1e} s" for name, value in found["from_march_s"].items())
    print(f"{6 * cells**3:10d} tetrahedra: {row}; largest deviation from our march: {apart}", flush=True)


if __name__ == "__main__":
    sys.exit(main())
