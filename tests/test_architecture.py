"""Imports go one way: a room of the package imports only the rooms below it."""

from __future__ import annotations

import ast
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import torch_pmil

PACKAGE = Path(torch_pmil.__file__).parent
ROOMS = (  # bottom first
    ("files",),
    ("checks",),
    ("seeds",),
    ("settings",),
    ("envs",),  # knows no mathematics
    ("gp",),
    ("control",),
    ("demonstrations",),
    ("model", "compiled"),  # reads posteriors and policies, and knows no trajectory but its own
    ("model",),
    ("search",),
    ("torchrl_interop",),
    ("trainer",),
    ("plotting",),  # draws numbers, and knows no experiment
    ("tasks",),  # what is learned
    ("runs", "diagnosis"),
    ("runs",),  # how a run goes
    ("cli",),
    ("__main__",),
)
MATHEMATICS = {("gp",), ("control",), ("model",), ("search",)}
WITHOUT_TORCHRL = {("files",), ("gp",), ("demonstrations",), ("plotting",)}
PURE = {  # of rooms at the edge of TorchRL, the files that compute
    "control/state_space.py",
    "control/trigonometric_polynomial.py",
    "control/rbf_policy.py",
    "control/exploration.py",
    "model/dynamics.py",
    "model/rollout.py",
    "model/particles.py",
    "model/calibration.py",
    "search/kl.py",
    "search/saturating_cost.py",
    "search/reparameterisation.py",
    "search/policy_search.py",
}
MOST_FILES, MOST_FOLDERS = 8, 12  # of the package's top level
# a robot, and the task on it; what a setting is, and those of a run
SAME_NAME = {
    "__init__.py",
    "biorob.py",
    "cart_pole.py",
    "double_pendulum.py",
    "double_pendulum_servo.py",
    "settings.py",
}


def name_of(path: Path) -> str:
    return path.relative_to(PACKAGE).as_posix()


FILES = {name_of(path): path for path in sorted(PACKAGE.rglob("*.py")) if path.parent != PACKAGE}
FILES |= {
    name: PACKAGE / name
    for name in ("files.py", "checks.py", "seeds.py", "settings.py", "__main__.py")
}


def room_of(module: str) -> tuple[str, ...]:
    """The room of a dotted name below the package: the longest that is one."""
    parts = tuple(module.split("."))
    return max((room for room in ROOMS if parts[: len(room)] == room), key=len, default=())


@cache
def tree_of(path: Path) -> ast.Module:
    return ast.parse(path.read_text())


def imports(tree: ast.AST) -> Iterator[str]:
    """Dotted names of all imported modules."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def imported_rooms(path: Path) -> set[tuple[str, ...]]:
    inside = [name for name in imports(tree_of(path)) if name.startswith("torch_pmil.")]
    return {room_of(name.removeprefix("torch_pmil.")) for name in inside}


def imported_packages(path: Path) -> set[str]:
    return {name.split(".")[0] for name in imports(tree_of(path))}


def room_of_file(name: str) -> tuple[str, ...]:
    return room_of(name.removesuffix(".py").removesuffix("/__init__").replace("/", "."))


def test_every_file_is_in_a_room() -> None:
    assert [name for name in FILES if not room_of_file(name)] == []


def test_rooms_import_only_rooms_below_them() -> None:
    upwards = [
        (name, ".".join(room))
        for name, path in FILES.items()
        for room in imported_rooms(path)
        if not room or ROOMS.index(room) > ROOMS.index(room_of_file(name))
    ]
    assert upwards == []


def test_imports_are_absolute_and_functions_import_nothing() -> None:
    functions = (ast.FunctionDef, ast.AsyncFunctionDef)
    within = [
        (name, node.lineno)
        for name, path in FILES.items()
        for node in ast.walk(tree_of(path))
        if getattr(node, "level", 0) or (isinstance(node, functions) and list(imports(node)))
    ]
    assert within == []


def test_environments_and_mathematics_do_not_know_each_other() -> None:
    known = [
        (name, ".".join(room))
        for name, path in FILES.items()
        for room in imported_rooms(path)
        if {room_of_file(name), room} & MATHEMATICS and {room_of_file(name), room} & {("envs",)}
    ]
    assert known == []


def test_readers_of_demonstrations_know_nothing_but_files() -> None:
    readers = [name for name in FILES if name.startswith("demonstrations/formats/")]
    rooms = {room for name in readers for room in imported_rooms(FILES[name])}
    assert rooms <= {("files",), ("demonstrations",)}


def test_torchrl_stays_at_the_edge() -> None:
    pure = [name for name in FILES if room_of_file(name) in WITHOUT_TORCHRL or name in PURE]
    known = [name for name in pure if imported_packages(FILES[name]) & {"torchrl", "tensordict"}]
    assert known == []
    assert FILES.keys() >= PURE


def test_matplotlib_is_imported_in_plotting_alone() -> None:
    drawing = {
        room_of_file(n) for n, path in FILES.items() if "matplotlib" in imported_packages(path)
    }
    assert drawing == {("plotting",)}


def test_top_level_is_small() -> None:
    entries = [path for path in PACKAGE.iterdir() if path.name != "__pycache__"]
    folders = [path.name for path in entries if path.is_dir()]
    assert len(entries) - len(folders) <= MOST_FILES
    assert len(folders) <= MOST_FOLDERS


def test_no_two_files_have_one_name_in_one_role() -> None:
    outside = [
        name for name in FILES if not name.startswith("plotting/")
    ]  # figures of what others compute
    counted = Counter(Path(name).name for name in outside if Path(name).name not in SAME_NAME)
    assert [name for name, count in counted.items() if count > 1] == []


def holds_tensors(node: ast.ClassDef) -> bool:
    fields = [
        ast.unparse(field.annotation) for field in node.body if isinstance(field, ast.AnnAssign)
    ]
    return any("Tensor" in kind and "Callable" not in kind for kind in fields)


def test_dataclasses_that_hold_tensors_are_compared_by_identity() -> None:
    """Equality of tensors is a tensor, of which a dataclass asks whether it is true."""
    compared = [
        (name, node.name)
        for name, path in FILES.items()
        for node in ast.walk(tree_of(path))
        if isinstance(node, ast.ClassDef) and holds_tensors(node)
        for decorator in map(ast.unparse, node.decorator_list)
        if decorator.startswith("dataclass") and "eq=False" not in decorator
    ]
    assert compared == []


def test_every_room_says_what_it_is_for() -> None:
    rooms = [path for path in PACKAGE.rglob("__init__.py") if path.parent != PACKAGE]
    assert [name_of(path) for path in rooms if not ast.get_docstring(tree_of(path))] == []


def loaded_by(statement: str) -> set[str]:
    """Top-level modules that a fresh interpreter has loaded after a statement."""
    code = f"{statement}; import sys; print(*{{name.partition('.')[0] for name in sys.modules}})"
    printed = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    return set(printed.stdout.split())


def test_importing_the_package_loads_nothing_heavy() -> None:
    heavy = {"torch", "gpytorch", "torchrl", "tensordict", "mujoco", "matplotlib", "hydra"}
    assert not loaded_by("import torch_pmil") & heavy


def test_training_loads_no_matplotlib_before_it_draws() -> None:
    assert "matplotlib" not in loaded_by("import torch_pmil.cli.train")


def loaded_statically(first: str) -> set[str]:
    """Top-level packages that a module of the package imports, by others of the package too."""
    seen, left, packages = set(), [first], set()
    while left:
        module = left.pop()
        path = PACKAGE.joinpath(*module.split("."))
        path = path / "__init__.py" if path.is_dir() else path.with_suffix(".py")
        if module in seen or not path.is_file():
            continue
        seen.add(module)
        for name in imports(tree_of(path)):
            inside = name.removeprefix("torch_pmil.")
            packages.add(name.split(".")[0])
            if inside != name:
                parts = inside.split(".")
                left += [".".join(parts[:length]) for length in range(1, len(parts) + 1)]
    return packages


def test_exact_moments_load_neither_simulator_nor_torchrl() -> None:
    for module in ("gp.moment_matching", "search.kl", "model.dynamics", "model.rollout"):
        assert not loaded_statically(module) & {"torchrl", "tensordict", "mujoco", "matplotlib"}


def test_public_mathematics_loads_neither_simulator_nor_torchrl() -> None:
    pure = {name.removesuffix(".py").replace("/", ".") for name in PURE}
    pure -= {"search.policy_search"}  # of a loss, which is TorchRL's
    stub = [
        node
        for node in ast.parse(PACKAGE.joinpath("__init__.pyi").read_text()).body
        if isinstance(node, ast.ImportFrom) and node.module
    ]
    of_pure = [node for node in stub if node.module.startswith("gp.") or node.module in pure]
    names = [alias.name for node in of_pure for alias in node.names]
    assert {"Gaussian", "RBFPolicy", "GPDynamics", "predict_trajectory", "gaussian_kl"} <= {*names}
    loaded = loaded_by(f"from torch_pmil import {', '.join(names)}")
    assert not loaded & {"torchrl", "tensordict", "mujoco", "gymnasium", "matplotlib"}


def test_importing_the_experiments_draws_nothing() -> None:
    assert "torchrl" in loaded_statically("tasks.task")
    assert "matplotlib" not in loaded_statically("tasks.registry")
