"""A beat of two ventricles, looked at from Python. Cells (# %%) run one by one in Jupyter (jupytext) and in editors; `python beat.py` runs all."""

# %% A study file of one's own, or one of the project's; settings change keys of the file.
import sys
import tempfile
from pathlib import Path

import numpy as np

import cardiotwin

root = Path(__file__).resolve().parents[2]
output = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(tempfile.mkdtemp())
study = cardiotwin.Study(
    root / "studies/02_biventricular_beat/linear.toml",
    output=output,
    settings={"anatomy.edge_length_mm": 9.0, "mechanics.step_s": 0.01, "output.figures": False},
)
study

# %% Run it; the callback hears stages and steps.
stages = []
results = study.run(progress=lambda stage, done, total: stages.append(stage) if stage not in stages else None)
print("stages:", ", ".join(stages))
print(f"{results.status}: EF {100 * results.summary['ejection_fraction_lv']:.0f} % left, {100 * results.summary['ejection_fraction_rv']:.0f} % right")

# %% Curves are arrays; pandas.DataFrame(results.curves) makes a table of them, and
# frame.plot("volume_lv_ml", "pressure_lv_kpa") the pressure-volume loop.
curves = results.curves
stroke_work_j = -np.trapezoid(curves["pressure_lv_kpa"], curves["volume_lv_ml"]) / 1000 if hasattr(np, "trapezoid") else np.nan
print(f"stroke work of the left ventricle {stroke_work_j:.2f} J")

# %% Meshes are arrays too: how far does the wall move, and how thick does it get?
times_s = results.mesh_times_s()
end_systole = int(np.argmin(results.frames["volume_lv_ml"]))
mesh = results.mesh(end_systole)
way_mm = np.linalg.norm(mesh.point_fields["displacement_mm"], axis=1)
radial = mesh.tetrahedron_fields["strain_radial"]
print(f"end-systole at {times_s[end_systole]:.2f} s: points move by up to {way_mm.max():.1f} mm, radial strain {100 * np.median(radial):.0f} %")

# %% In three dimensions, where PyVista is at hand.
try:
    import pyvista
except ImportError:
    print("pyvista is not installed: no picture")
else:
    grid = pyvista.UnstructuredGrid({pyvista.CellType.TETRA: mesh.tetrahedra}, mesh.points)
    grid["displacement (mm)"] = way_mm
    pyvista.OFF_SCREEN = True
    grid.plot(scalars="displacement (mm)", screenshot=output / "end_systole.png")
