"""Ours and cloning over the mass: each robot has its mass and its runs, and each number is at its
place.
"""

from __future__ import annotations

import pickle
from collections.abc import Iterator, Sequence
from pathlib import Path
from types import SimpleNamespace

import pytest
import torch
from torch import Tensor

from reproduction import masses
from reproduction.masses import SECOND_LINKS, SEEDS, TRIALS, needed_runs, results, with_second_link
from torch_pmil.demonstrations import shipped_demonstrations
from torch_pmil.envs.rollouts import rollout_of
from torch_pmil.tasks.double_pendulum import states_from_positions
from torch_pmil.tasks.registry import load_experiment
from torch_pmil.tasks.task import Task


def mass_of(robot: Task) -> float:
    """Of the second link that it simulates."""
    return robot.make_env(seed=0).model.body("link2").mass.item()


def shipped_pairs(seeds: Sequence[int]) -> Iterator[tuple[Tensor, Tensor]]:
    """The shipped demonstrations for each seed, as if no torque had been applied."""
    shipped = shipped_demonstrations("double_pendulum")
    states = states_from_positions(shipped.positions, shipped.time_step)
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


def test_every_robot_has_a_folder_for_every_seed_and_the_plain_one_is_shared(
    tmp_path: Path,
) -> None:
    runs, quick = needed_runs(tmp_path, False), needed_runs(tmp_path, True)
    assert len({run.out for run in runs}) == len(runs) == len(SECOND_LINKS) * len(SEEDS)
    assert {tmp_path / "double_pendulum" / f"seed_{seed}" for seed in SEEDS} < {
        run.out for run in runs
    }
    assert len(quick) == len(SECOND_LINKS)
    assert [{run.learn.keywords["trials"] for run in some} for some in (runs, quick)] == [
        {TRIALS},
        {3},
    ]


def test_runs_can_be_learned_in_another_process(tmp_path: Path) -> None:
    for run in needed_runs(tmp_path, False):
        sent = pickle.loads(pickle.dumps(run))
        assert mass_of(sent.learn.keywords["experiment"]) == mass_of(
            run.learn.keywords["experiment"]
        )


def test_every_number_is_at_its_mass(monkeypatch: pytest.MonkeyPatch) -> None:
    measured: list[tuple[Path, float, int]] = []

    def remeasured(folder: Path, robot: Task, starts: int, seed: int) -> dict[str, object]:
        measured.append((folder, mass_of(robot), seed))
        return {"success_rate": mass_of(robot) / int(folder.name[-1])}

    def load_learned(folder: Path, robot: Task) -> SimpleNamespace:
        return SimpleNamespace(
            rollouts=lambda robot, starts, seed: rollout_of(
                torch.zeros(starts, 26, 4, dtype=torch.float64)
            )
        )

    monkeypatch.setattr(masses, "remeasured", remeasured)
    monkeypatch.setattr(masses, "load_learned", load_learned)
    monkeypatch.setattr(masses, "record_pairs", shipped_pairs)
    monkeypatch.setattr(masses, "clone_double_pendulum", lambda states, torques: None)
    monkeypatch.setattr(
        masses, "measured_success", lambda policy, robot, starts, seed: 1 - mass_of(robot)
    )
    folders = [Path(f"{mass}kg/seed_{seed}") for mass in SECOND_LINKS for seed in (1, 2)]
    made = results(folders, quick=True)
    assert [f"{mass}kg" for _, mass, _ in measured] == [
        folder.parent.name for folder, *_ in measured
    ]
    from_upright = shipped_demonstrations("double_pendulum").positions.mean(0)[1:] - torch.tensor(
        [0.0, 0.5, 0.0, 1.0]
    )
    standing = from_upright.square().sum().div(2 * 25).sqrt().item()
    for mass in SECOND_LINKS:
        assert made.headline[f"ours_success_{mass:g}kg"] == pytest.approx(0.75 * mass)
        assert made.headline[f"ours_departure_m_{mass:g}kg"] == pytest.approx(standing)
        assert made.headline[f"cloning_success_{mass:g}kg"] == pytest.approx(1 - mass)
    peaks = [made.headline[f"peak_torque_{mass:g}kg"] for mass in SECOND_LINKS]
    assert peaks == pytest.approx(
        [max(column) for column in zip(*made.details["peak_torques"], strict=True)]
    )
    assert made.headline["torque_limit"] == 3.5
    upper, _ = made.figures["masses"].axes
    assert [container.get_label() for container in upper.containers] == [
        "ours",
        "behavioural cloning",
    ]
    assert upper.containers[0].lines[0].get_ydata() == pytest.approx(
        [75 * mass for mass in SECOND_LINKS]
    )
