"""Imports go one way: a module imports only what stands below it."""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import torch_pmil

PACKAGE = Path(torch_pmil.__file__).parent

FLOORS = (  # bottom first; modules of one floor may import each other
    {"envs", "files"},  # know nothing of the mathematics, see below
    {"functions", "gaussian", "lbfgs", "first_motion"},
    {
        "recurrence",
        "trigonometry",
        "kernel_expansion",
        "exponential_sums",
        "kl",
        "saturating_cost",
        "marginal_likelihood",
        "writing",
    },
    {"gaussian_integrals"},
    {"moment_matching"},
    {"linearised_moments"},
    {"state_space"},
    {
        "demonstrations",
        "alignment",
        "drawing",
        "smoothing",
        "jumps",
        "camera",
        "modes",
        "demonstration_checks",
        "diagnosis",
    }
    | {"expert", "evaluation", "trigonometric_polynomial"},
    {"dynamics", "hyperparameters", "experience", "policy", "sampling_frequency"},
    {"linearised_step", "state_policy", "saved_policy", "calibration"},
    {"rollout", "particles"},
    {"trajectory_loss"},
    {"objective", "conditioning"},
    {"multi_target"},
    {"policy_search"},
    {"search_stepper", "lbfgs_stepper", "collection", "checkpoints", "trials"},
    {"trainer", "torchrl_interop", "run"},
    {"baselines", "plotting"},  # plots draw numbers and know no experiment
    {"experiments"},
    {"video", "report", "configs", "__main__"},  # command lines may use everything
)
LEVEL = {room: level for level, rooms in enumerate(FLOORS) for room in rooms}
MATHEMATICS = {room for room in LEVEL if LEVEL[room] <= LEVEL["policy_search"]} - {
    "envs",
    "files",
    "demonstrations",
}
ABOVE_SEARCH = {room for room in LEVEL if LEVEL[room] > LEVEL["policy_search"]}
DRAWN = {"plotting", "video", "report"}
OF_TORCHRL = {
    "envs",
    "experience",
    "state_policy",
    "trajectory_loss",
    "objective",
} | ABOVE_SEARCH - {"baselines"} - DRAWN
FILES = sorted(path for path in PACKAGE.rglob("*.py") if path != PACKAGE / "__init__.py")


def room_of(path: Path) -> str:
    """The part of the package that a file belongs to: its own name, or its folder's. A folder's
    command line is apart.
    """
    return (
        path.stem
        if path.stem == "__main__"
        else path.relative_to(PACKAGE).parts[0].removesuffix(".py")
    )


def imports(tree: ast.AST) -> Iterator[str]:
    """Dotted names of all imported modules."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"relative import in line {node.lineno}"
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def imported_rooms(path: Path) -> set[str]:
    """Parts of the package that a file imports, its own aside."""
    modules = (name.split(".") for name in imports(ast.parse(path.read_text())))
    return {parts[1] for parts in modules if parts[0] == "torch_pmil"} - {room_of(path)}


def imported_packages(path: Path) -> set[str]:
    return {name.split(".")[0] for name in imports(ast.parse(path.read_text()))}


each_file = pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(PACKAGE)))


@each_file
def test_every_module_has_a_floor(path: Path) -> None:
    assert room_of(path) in LEVEL


@each_file
def test_nobody_imports_upwards(path: Path) -> None:
    above = {room for room in imported_rooms(path) if LEVEL.get(room, 0) > LEVEL[room_of(path)]}
    assert not above


@each_file
def test_nobody_imports_the_package_itself(path: Path) -> None:
    assert imported_rooms(path) <= set(LEVEL)


def test_environments_import_no_mathematics() -> None:
    assert (
        not {room for path in (PACKAGE / "envs").rglob("*.py") for room in imported_rooms(path)}
        & MATHEMATICS
    )


def test_mathematics_imports_no_environment() -> None:
    assert not [
        path.name
        for path in FILES
        if room_of(path) in MATHEMATICS and "envs" in imported_rooms(path)
    ]


def test_demonstrations_are_files_alone() -> None:
    modules = [
        path for path in (PACKAGE / "demonstrations").glob("*.py") if path.stem != "__main__"
    ]
    assert {room for path in modules for room in imported_rooms(path)} == {"files"}


@each_file
def test_torchrl_stays_at_the_edge(path: Path) -> None:
    assert room_of(path) in OF_TORCHRL or not imported_packages(path) & {"torchrl", "tensordict"}


@each_file
def test_matplotlib_is_imported_in_plotting_alone(path: Path) -> None:
    assert room_of(path) == "plotting" or "matplotlib" not in imported_packages(path)


@each_file
def test_functions_import_nothing(path: Path) -> None:
    functions = [
        node
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef))
    ]
    assert not {name for function in functions for name in imports(function)}


def test_importing_the_experiments_draws_nothing() -> None:
    told = "import sys, torch_pmil.experiments; sys.exit('matplotlib' in sys.modules)"
    assert (
        subprocess.run([sys.executable, "-c", told], cwd=PACKAGE.parent, check=False).returncode
        == 0
    )
