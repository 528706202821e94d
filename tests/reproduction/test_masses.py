"""Ours and cloning over the mass: each robot has its mass and its runs, each number its place."""

from __future__ import annotations

import pickle
from collections.abc import Iterator, Sequence
from pathlib import Path
from types import SimpleNamespace

import pytest
import torch
from tensordict import TensorDict
from torch import Tensor

from reproduction import masses
from reproduction.masses import SECOND_LINKS, SEEDS, TRIALS, needed_runs, results, with_second_link
from torch_pmil.demonstrations import shipped_demonstrations
from torch_pmil.envs.rollouts import rollout_of
from torch_pmil.tasks.registry import load_experiment
from torch_pmil.tasks.task import Task


def mass_of(robot: Task) -> float:
    """Of the second link that it simulates."""
    return robot.make_env(seed=0).model.body("link2").mass.item()


def shipped_pairs(seeds: Sequence[int]) -> Iterator[tuple[Tensor, Tensor]]:
    """The shipped demonstrations for each seed, as if no torque had been applied."""
    states = load_experiment("double_pendulum").demonstrated_states.unflatten(0, (5, -1))
    for _ in seeds:
        yield states, torch.zeros(5, 25, 2, dtype=torch.float64)


@pytest.mark.parametrize("mass", SECOND_LINKS)
def test_robot_has_its_mass_and_all_else_of_the_double_pendulum(mass: float) -> None:
    robot, plain = with_second_link(mass), load_experiment("double_pendulum")
    assert mass_of(robot) == mass
    assert robot.make_env(seed=0).model.body("link1").mass.item() == 0.5
    assert (robot.name == plain.name) == (mass == 0.5)
    assert torch.equal(robot.demonstrations.positions, plain.demonstrations.positions)
    assert robot.settings == plain.settings


def test_every_robot_has_a_folder_for_every_seed_and_goes_to_other_processes(
    tmp_path: Path,
) -> None:
    """The runs of the plain one are shared."""
    runs, quick = needed_runs(tmp_path, False), needed_runs(tmp_path, True)
    folders = {run.out for run in runs}
    assert len(folders) == len(runs) == len(SECOND_LINKS) * len(SEEDS)
    assert {tmp_path / "double_pendulum" / f"seed_{seed}" for seed in SEEDS} < folders
    assert len(quick) == len(SECOND_LINKS)
    for some, trials in ((runs, TRIALS), (quick, 3)):
        assert {run.learn.keywords["trials"] for run in some} == {trials}
    for run in runs:
        sent, meant = (
            mass_of(one.learn.keywords["experiment"])
            for one in (pickle.loads(pickle.dumps(run)), run)
        )
        assert sent == meant


def test_every_number_is_at_its_mass(monkeypatch: pytest.MonkeyPatch) -> None:
    measured: list[tuple[Path, float, int]] = []

    def remeasured(folder: Path, robot: Task, starts: int, seed: int) -> dict[str, object]:
        measured.append((folder, mass_of(robot), seed))
        return {"success_rate": mass_of(robot) / int(folder.name[-1])}

    def load_learned(folder: Path, robot: Task) -> SimpleNamespace:
        def rollouts(robot: Task, starts: int, seed: int) -> TensorDict:
            return rollout_of(torch.zeros(starts, 26, 4, dtype=torch.float64))

        return SimpleNamespace(rollouts=rollouts)

    stubs = {
        "remeasured": remeasured,
        "load_learned": load_learned,
        "record_pairs": shipped_pairs,
        "clone_double_pendulum": lambda states, torques: None,
        "measured_success": lambda policy, robot, starts, seed: 1 - mass_of(robot),
    }
    for name, stub in stubs.items():
        monkeypatch.setattr(masses, name, stub)
    folders = [Path(f"{mass}kg/seed_{seed}") for mass in SECOND_LINKS for seed in (1, 2)]
    made = results(folders, quick=True)
    assert all(f"{mass}kg" == folder.parent.name for folder, mass, _ in measured)
    shown = shipped_demonstrations("double_pendulum").positions.mean(0)[1:]
    from_upright = shown - torch.tensor([0.0, 0.5, 0.0, 1.0])
    standing = from_upright.square().sum().div(2 * 25).sqrt().item()
    for mass in SECOND_LINKS:
        assert made.headline[f"ours_success_{mass:g}kg"] == pytest.approx(0.75 * mass)
        assert made.headline[f"ours_departure_m_{mass:g}kg"] == pytest.approx(standing)
        assert made.headline[f"cloning_success_{mass:g}kg"] == pytest.approx(1 - mass)
    peaks = [made.headline[f"peak_torque_{mass:g}kg"] for mass in SECOND_LINKS]
    largest = map(max, zip(*made.details["peak_torques"], strict=True))
    assert peaks == pytest.approx(list(largest))
    assert made.headline["torque_limit"] == 3.5
    upper, _ = made.figures["masses"].axes
    labels = [container.get_label() for container in upper.containers]
    assert labels == ["ours", "behavioural cloning"]
    drawn = upper.containers[0].lines[0].get_ydata()
    assert drawn == pytest.approx([75 * mass for mass in SECOND_LINKS])
