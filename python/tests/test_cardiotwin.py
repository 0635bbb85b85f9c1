"""The door from outside: what comes in is refused with words or runs, what comes out is what the files hold."""

import csv
import json
import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest

import cardiotwin

ROOT = Path(__file__).resolve().parents[2]
BEAT = """
kind = "simulate"
[anatomy]
edge_length_mm = 12.0
[anatomy.idealised_lv]
[mechanics]
step_s = 0.01
[simulation]
frames = 5
[output]
figures = false
"""


def study_file(folder, text=BEAT):
    file = folder / "study.toml"
    file.write_text(text)
    return file


@pytest.fixture(scope="module")
def beat(tmp_path_factory):
    folder = tmp_path_factory.mktemp("beat")
    heard = []
    study = cardiotwin.Study(study_file(folder), output=folder / "results")
    results = study.run(progress=lambda stage, done, total: heard.append((stage, done, total)))
    return study, results, heard


def test_a_study_says_what_it_is(beat):
    study, results, _ = beat
    assert study.kind == "simulate"
    assert Path(study.output) == Path(results.directory)
    assert "Billet2009" in study.cite()
    assert "simulate" in repr(study)


def test_progress_hears_the_stages_in_order_and_the_last_step(beat):
    _, _, heard = beat
    stages = list(dict.fromkeys(stage for stage, _, _ in heard))
    assert stages == ["building the anatomy", "activating and assembling", "beating", "writing results"]
    beating = [(done, total) for stage, done, total in heard if stage == "beating"]
    assert beating[-1][0] == beating[-1][1] > 10
    assert [done for done, _ in beating] == sorted(done for done, _ in beating)


def test_columns_are_what_the_files_hold(beat):
    _, results, _ = beat
    assert {"curves", "frames", "segments"} <= set(results.tables)
    with open(Path(results.directory) / "curves.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    curves = results.curves
    assert list(curves) == list(rows[0])
    for name in ["time_s", "volume_lv_ml", "pressure_lv_kpa"]:
        assert curves[name].dtype == np.float64
        assert curves[name].tolist() == [float(row[name]) for row in rows]
    assert curves["phase_lv"].tolist() == [row["phase_lv"] for row in rows]
    assert np.isnan(curves["volume_rv_ml"]).all()
    summary = json.loads((Path(results.directory) / "summary.json").read_text())
    assert results.summary == summary and results.status == "converged"


def test_meshes_hold_the_volume_of_the_curves(beat):
    """The cavity, closed by the rim's centre as in the model, has the volume that frames.csv says."""
    _, results, _ = beat
    times_s = results.mesh_times_s()
    assert len(times_s) == len(results.frames["time_s"]) == 6
    for frame in range(len(times_s)):
        mesh = results.mesh(frame)
        assert mesh.time_s == times_s[frame] == pytest.approx(results.frames["time_s"][frame])
        assert mesh.points.shape[1] == 3 and mesh.tetrahedra.shape[1] == 4 and mesh.tetrahedra.dtype == np.int64
        assert cavity_ml(mesh) == pytest.approx(results.frames["volume_lv_ml"][frame], abs=1e-3)
    assert mesh.point_fields["displacement_mm"].shape == mesh.points.shape
    assert mesh.tetrahedron_fields["active_stress_kpa"].shape == (len(mesh.tetrahedra),)
    rest_mm = mesh.points - mesh.point_fields["displacement_mm"]
    other = results.mesh(0)
    assert rest_mm == pytest.approx(other.points - other.point_fields["displacement_mm"], abs=1e-4)
    assert results.mesh(-1).time_s == times_s[-1]
    with pytest.raises(IndexError, match="frame 6 of 6"):
        results.mesh(6)


def cavity_ml(mesh):
    """Divergence theorem over the inner of the mesh's two boundary sheets: the faces where depth is 0, and a lid around its rim's centre."""
    faces = np.concatenate([mesh.tetrahedra[:, corners] for corners in ([0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2])])
    _, first, count = np.unique(np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True)
    boundary = faces[first[count == 1]]
    inner = boundary[(mesh.point_fields["transmural_depth"][boundary] < 1e-9).all(axis=1)]
    edges = np.concatenate([inner[:, [0, 1]], inner[:, [1, 2]], inner[:, [2, 0]]])
    _, first, count = np.unique(np.sort(edges, axis=1), axis=0, return_index=True, return_counts=True)
    rim = edges[first[count == 1]]
    centre = mesh.points[np.unique(rim)].mean(axis=0)
    a, b, c = (mesh.points[inner[:, n]] - centre for n in range(3))
    return abs(np.einsum("ij,ij->i", a, np.cross(b, c)).sum()) / 6000


def test_settings_of_every_type_reach_the_study(tmp_path):
    file = study_file(tmp_path)
    settings = {"mechanics.step_s": 0.02, "output.meshes": False, "mechanics.kinematics": "linear", "anatomy.septal_direction": [1, 0.5, 0]}
    results = cardiotwin.Study(file, settings=settings).run()
    assert np.diff(results.curves["time_s"])[0] == pytest.approx(0.02)
    assert len(results.mesh_times_s()) == 0
    assert cardiotwin.Results(tmp_path / "results").status == "converged"


def test_what_is_wrong_is_said(tmp_path):
    with pytest.raises(cardiotwin.CardiotwinError, match="cannot read the study file"):
        cardiotwin.Study(tmp_path / "none.toml")
    with pytest.raises(cardiotwin.CardiotwinError, match="did you mean `step_s`"):
        cardiotwin.Study(study_file(tmp_path), settings={"mechanics.steps": 0.01})
    with pytest.raises(cardiotwin.CardiotwinError, match="no summary.json"):
        cardiotwin.Results(tmp_path)
    (tmp_path / "labels.nii.gz").write_text("this is no image")
    study = cardiotwin.Study(study_file(tmp_path, 'kind = "simulate"\n[anatomy]\nlabels = "labels.nii.gz"\n'))
    with pytest.raises(cardiotwin.CardiotwinError, match="labels.nii.gz"):
        study.run()


def test_an_exception_of_the_callback_stops_the_run_and_is_raised(tmp_path):
    def refuse(stage, done, total):
        if stage == "beating" and done > 3:
            raise ValueError("enough")

    study = cardiotwin.Study(study_file(tmp_path), settings={"mechanics.step_s": 0.0001, "simulation.beats": 100})
    with pytest.raises(ValueError, match="enough"):
        study.run(progress=refuse)
    assert cardiotwin.Results(study.output).status == "stopped"


@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
def test_ctrl_c_raises_keyboard_interrupt_and_what_was_found_is_written(tmp_path):
    study = cardiotwin.Study(study_file(tmp_path), settings={"mechanics.step_s": 0.0001, "simulation.beats": 500})
    # Whoever starts the tests in the background may have had the signal ignored.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    timer = threading.Timer(2.0, lambda: os.kill(os.getpid(), signal.SIGINT))
    timer.start()
    with pytest.raises(KeyboardInterrupt):
        study.run()
    assert cardiotwin.Results(study.output).status == "stopped"


def test_other_threads_go_on_while_a_study_runs(tmp_path):
    study = cardiotwin.Study(study_file(tmp_path))
    counted = 0
    running = threading.Thread(target=study.run)
    running.start()
    while running.is_alive():
        counted += 1
    assert counted > 1000


def test_parameters_are_those_of_the_model():
    rows = {row["name"]: row for row in cardiotwin.parameters()}
    assert len(rows) > 30
    sigma = rows["contraction_peak_lv_kpa"]
    assert sigma["unit"] == "kPa" and sigma["lower"] <= sigma["default"] <= sigma["upper"]


def test_the_stub_names_what_the_module_has():
    stub = (ROOT / "python/cardiotwin.pyi").read_text()
    for name in ["Study", "Results", "Mesh"]:
        for member in vars(getattr(cardiotwin, name)):
            if not member.startswith("_"):
                assert f"def {member}(" in stub, f"{name}.{member}"
    for name in vars(cardiotwin):
        if not name.startswith("_") and name != "cardiotwin":
            assert f"class {name}" in stub or f"def {name}(" in stub, name


def test_the_example_runs(tmp_path):
    example = ROOT / "python/examples/beat.py"
    done = subprocess.run([sys.executable, example, tmp_path], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "converged: EF" in done.stdout and "stroke work" in done.stdout
