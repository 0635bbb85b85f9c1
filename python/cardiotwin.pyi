"""From cine MRI to a personalised, beating heart: load a study, run it, get curves, parameters and meshes as numpy arrays."""

from collections.abc import Callable, Mapping
from os import PathLike
from pathlib import Path
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

__version__: str

class CardiotwinError(Exception):
    """A study file, a file that it names or a run is wrong; the text says what, where and what to do."""

@final
class Study:
    """A study file, read and checked."""

    def __init__(
        self,
        path: str | PathLike[str],
        data: str | PathLike[str] | None = None,
        output: str | PathLike[str] | None = None,
        settings: Mapping[str, object] | None = None,
    ) -> None:
        """`data` and `output` replace the folders of the data and of the results; `settings` sets keys of the file, {"mechanics.step_s": 0.01}."""
    @property
    def kind(self) -> str:
        """What the study does: "simulate", "track", "personalise", …"""
    @property
    def output(self) -> Path:
        """The folder of the results."""
    def cite(self) -> str:
        """The references of what the study uses, as BibTeX."""
    def run(self, progress: Callable[[str, int, int | None], object] | None = None) -> Results:
        """Runs the study and leaves its files in `output`.

        `progress(stage, done, total)` is called as the run goes on. Ctrl-C ends the run at its next step, with what was found by then written, and
        raises KeyboardInterrupt.
        """

@final
class Results:
    """The folder of a finished run."""

    def __init__(self, path: str | PathLike[str]) -> None: ...
    @property
    def directory(self) -> Path: ...
    @property
    def summary(self) -> dict[str, Any]:
        """`summary.json`: status, ejection fractions, volumes, pressures, warnings, provenance."""
    @property
    def status(self) -> str:
        """How the run ended: "converged", "on_bound", "iteration_limit", "stopped" or "failed"."""
    @property
    def tables(self) -> list[str]:
        """Names of the tables (CSV files), without their ending."""
    def table(self, name: str) -> dict[str, NDArray[np.float64] | NDArray[np.str_]]:
        """A table by its columns, ready for pandas.DataFrame; an empty cell among numbers is NaN."""
    @property
    def curves(self) -> dict[str, NDArray[np.float64] | NDArray[np.str_]]:
        """Volumes, pressures and phases at every step."""
    @property
    def frames(self) -> dict[str, NDArray[np.float64] | NDArray[np.str_]]:
        """The same at the images' times."""
    @property
    def parameters(self) -> dict[str, NDArray[np.float64] | NDArray[np.str_]]:
        """Parameters found with bounds and intervals, and those that were held."""
    def mesh_times_s(self, series: str = "heart") -> NDArray[np.float64]:
        """Times of the beating mesh, s; empty where the run wrote no meshes."""
    def mesh(self, frame: int, series: str = "heart") -> Mesh:
        """The mesh at one of these times, by its place in them; a negative one counts from the end."""

@final
class Mesh:
    """A heart at one time. Lengths are mm in world coordinates (RAS)."""

    @property
    def time_s(self) -> float: ...
    @property
    def points(self) -> NDArray[np.float64]:
        """Positions, shape (vertices, 3)."""
    @property
    def tetrahedra(self) -> NDArray[np.int64]:
        """Corners, shape (tetrahedra, 4), counted from 0."""
    @property
    def point_fields(self) -> dict[str, NDArray[np.float64]]:
        """Fields of the points by name, shape (vertices,) or (vertices, components)."""
    @property
    def tetrahedron_fields(self) -> dict[str, NDArray[np.float64]]:
        """Fields of the tetrahedra by name."""

def parameters() -> list[dict[str, str | float]]:
    """Every parameter of the model: name, unit, default, lower, upper, meaning, source."""
