"""Our designs and values through SALib: its indices must be ours, to 1e-6.

    python3 benches/peers/sensitivity.py [runs.csv indices.csv]

Makes a throw-away virtual environment for SALib. Without arguments the values are those of Ishigami's and Sobol's g-function at our Sobol' and
Morris designs (`cargo run --release --example sensitivity_case`); with the tables of a study by Sobol' indices, those of its outputs. Exact values of
the two functions are printed beside ours.
"""

import pathlib
import subprocess
import sys
import tempfile
import venv

ALLOWED = 1e-6
EXACT = {  # Ishigami with a = 7, b = 0.1, and g with a = (0, 0.5, 3, 9, 99, 99): first order, then total
    3: ([0.313905, 0.442411, 0.0], [0.557589, 0.442411, 0.243684]),
    6: ([0.586781, 0.260792, 0.036674, 0.005868, 0.000059, 0.000059], [0.690086, 0.356173, 0.056334, 0.009171, 0.000092, 0.000092]),
}


def in_environment_of_its_own():
    with tempfile.TemporaryDirectory() as folder:
        venv.create(folder, with_pip=True)
        python = str(pathlib.Path(folder, "bin", "python"))
        subprocess.run([python, "-m", "pip", "install", "--quiet", "SALib", "pandas"], check=True)
        return subprocess.run([python, __file__, "--measure", *sys.argv[1:]]).returncode


def problem(count):
    return {"num_vars": count, "names": [str(i) for i in range(count)], "bounds": [[0.0, 1.0]] * count}


def theirs_by_sobol(count, values, pairs):
    from SALib.analyze import sobol

    found = sobol.analyze(problem(count), values, calc_second_order=pairs, num_resamples=2, seed=1)
    indices = {("FirstOrder", i, None): found["S1"][i] for i in range(count)}
    indices |= {("Total", i, None): found["ST"][i] for i in range(count)}
    if pairs:
        indices |= {("SecondOrder", i, j): found["S2"][i][j] for i in range(count) for j in range(i + 1, count)}
    return indices


def theirs_by_morris(count, places, values):
    from SALib.analyze import morris

    levels = len({place for row in places for place in row})
    found = morris.analyze(problem(count), places, values, num_levels=levels, num_resamples=2, seed=1)
    names = {"mu": "MeanEffect", "mu_star": "MeanAbsoluteEffect", "sigma": "EffectSpread"}
    return {(names[name], i, None): found[name][i] for name in names for i in range(count)}


def compare(title, ours, theirs):
    assert ours.keys() == theirs.keys(), "we and SALib do not speak of the same indices"
    difference = max(abs(ours[key] - theirs[key]) for key in ours)
    print(f"{title}: {len(ours)} indices, greatest difference {difference:.1e}")
    return difference <= ALLOWED


def functions():
    import numpy

    root = pathlib.Path(__file__).resolve().parents[2]
    command = ["cargo", "run", "--release", "--quiet", "--example", "sensitivity_case"]
    text = subprocess.run(command, cwd=root, check=True, capture_output=True, text=True).stdout
    good = True
    for block in text.strip().split("\n\n"):
        points, indices = (part.strip().splitlines() for part in block.split("="))
        table = numpy.array([[float(word) for word in line.split()[1:]] for line in points])
        places, values, count = table[:, :-1], table[:, -1], table.shape[1] - 1
        rows = [line.split() for line in indices]
        ours = {(measure, int(i), None if j == "-" else int(j)): float(value) for measure, i, j, value in rows}
        name = {3: "Ishigami", 6: "g"}[count]
        if points[0].startswith("sobol"):
            good &= compare(f"{name}, Sobol'", ours, theirs_by_sobol(count, values, True))
            for measure, exact in zip(("FirstOrder", "Total"), EXACT[count]):
                found = [ours[measure, i, None] for i in range(count)]
                print(f"  {measure:10} " + "  ".join(f"{value:.4f} ({truth:.4f})" for value, truth in zip(found, exact)))
        else:
            good &= compare(f"{name}, Morris", ours, theirs_by_morris(count, places, values))
    return good


def study(runs_file, indices_file):
    import pandas

    runs, indices = pandas.read_csv(runs_file), pandas.read_csv(indices_file)
    inputs = list(dict.fromkeys(indices.input))
    outputs = list(dict.fromkeys(indices.output))
    words = {"first_order": "FirstOrder", "total": "Total", "second_order": "SecondOrder"}
    good = True
    for output in outputs:
        rows = indices[indices.output == output]
        place = {name: number for number, name in enumerate(inputs)}
        partner = [None if pandas.isna(name) else place[name] for name in rows.partner]
        ours = {(words[m], place[i], j): v for m, i, j, v in zip(rows.measure, rows.input, partner, rows.value)}
        if runs[output].isna().any():
            print(f"{output}: has gaps, which SALib does not know")
            continue
        pairs = "second_order" in set(rows.measure)
        good &= compare(output, ours, theirs_by_sobol(len(inputs), runs[output].to_numpy(), pairs))
    return good


if __name__ == "__main__":
    if "--measure" not in sys.argv:
        sys.exit(in_environment_of_its_own())
    files = sys.argv[sys.argv.index("--measure") + 1 :]
    sys.exit(0 if (study(*files) if files else functions()) else f"indices differ by more than {ALLOWED}")
