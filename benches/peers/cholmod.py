"""Factorisation and solves of the step matrix side by side with CHOLMOD (scikit-sparse), ordered by METIS, on one core.

    sudo apt-get install libsuitesparse-dev libopenblas0-pthread   # CHOLMOD with METIS, and a fast BLAS beneath it
    python3 benches/peers/cholmod.py [5k] [15k] [40k]

Makes a throw-away virtual environment for numpy, scipy and scikit-sparse. Our side is `cargo bench --bench factorisation`, which obeys this
script: both sides take turns on the same matrix, each is charged its own processor seconds as Linux counts them, and what is printed are the
medians and the median of the rounds' ratios (ours to theirs; below 1 we are faster). The peer's matrix-vector conversions are not counted.
"""

import os
import pathlib
import subprocess
import sys
import tempfile
import venv

from servant import ONE_THREAD, Servant

PACKAGES = ["numpy<2", "scipy", "scikit-sparse==0.4.16", "cython<3.1", "setuptools<81"]
SIZES = [("5k", "4.05", 9), ("15k", "2.66", 7), ("40k", "1.85", 5)]


def in_environment_of_its_own():
    with tempfile.TemporaryDirectory() as folder:
        venv.create(folder, with_pip=True)
        python = str(pathlib.Path(folder, "bin", "python"))
        subprocess.run([python, "-m", "pip", "install", "--quiet", *PACKAGES], check=True)
        return subprocess.run([python, __file__, "--measure", *sys.argv[1:]], env={**os.environ, **ONE_THREAD}).returncode


def measure():
    import statistics
    import time

    import numpy
    import scipy.sparse
    from sksparse.cholmod import analyze

    def theirs(action):
        before = time.thread_time()
        action()
        return time.thread_time() - before

    def row(what, pairs):
        ours, peers = (statistics.median(side) for side in zip(*pairs))
        ratio = statistics.median(a / b for a, b in pairs)
        print(f"{what:24} ours {ours:8.4f} s   CHOLMOD {peers:8.4f} s   ratio {ratio:.2f}", flush=True)

    servant = Servant("factorisation")
    wanted = sys.argv[2:]
    for name, edge, rounds in SIZES:
        if wanted and name not in wanted:
            continue
        with tempfile.NamedTemporaryFile() as file:
            servant.seconds(f"matrix {edge} {file.name}")
            unknowns, entries = (int(count) for count in numpy.fromfile(file.name, "<u8", 2))
            rows = numpy.fromfile(file.name, "<u4", entries, offset=16)
            columns = numpy.fromfile(file.name, "<u4", entries, offset=16 + 4 * entries)
            values = numpy.fromfile(file.name, "<f8", entries, offset=16 + 8 * entries)
        matrix = scipy.sparse.csc_matrix((values, (rows, columns)), (unknowns, unknowns))
        factor = analyze(matrix, mode="supernodal", ordering_method="metis")
        factor.cholesky_inplace(matrix)
        print(f"{unknowns // 3} vertices")
        row("factorise", [(servant.seconds("factorise"), theirs(lambda: factor.cholesky_inplace(matrix))) for _ in range(rounds)])
        for count in (1, 3, 32):
            right = numpy.asfortranarray(numpy.ones((unknowns, count)))
            row(f"solve {count}", [(servant.seconds(f"solve {count}"), theirs(lambda: factor(right))) for _ in range(2 * rounds)])


if __name__ == "__main__":
    sys.exit(measure() if "--measure" in sys.argv else in_environment_of_its_own())
