"""The page on deployment: its code runs, and its numbers are those of the results."""

from __future__ import annotations

import json
import re
import shlex
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import torch

from tests.helpers.run_script import run_command
from torch_pmil.control.policy_file import load_policy, save_policy
from torch_pmil.experiments import load_experiment

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "how_to" / "deploy.md").read_text()
BLOCKS = re.findall(r"^```python\n(.*?)^```", PAGE, flags=re.MULTILINE | re.DOTALL)
COMMANDS = re.findall(r"^    pmil (.*)$", PAGE, flags=re.MULTILINE)
RUN = Path("runs/double_pendulum/seed_0")


class Robot:
    """Stands where it starts, and remembers what it was sent and when."""

    def __init__(self, start: np.ndarray) -> None:
        self.start, self.torques, self.times = start, [], []

    def read_state(self) -> np.ndarray:
        return self.start

    def send_torque(self, torque: np.ndarray) -> None:
        self.torques.append(torque)
        self.times.append(time.monotonic())


@pytest.fixture(scope="module")
def robot() -> Robot:
    return Robot(np.array([np.pi, 0.1, 0.0, -0.1]))


@pytest.fixture(scope="module")
def namespace(robot: Robot, tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict]:
    """What the page's code leaves, run from top to bottom where a run has left its policy."""
    folder = tmp_path_factory.mktemp("page")
    experiment = load_experiment("double_pendulum")
    (folder / RUN).mkdir(parents=True)
    network = experiment.make_policy(torch.Generator().manual_seed(0))
    save_policy(
        folder / RUN / "policy.pt", network, experiment.space, control_period=0.02
    )  # so that the test is short
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        run_command(patch, *shlex.split(COMMANDS[0]))
        names: dict = {"read_state": robot.read_state, "send_torque": robot.send_torque}
        for block in BLOCKS:
            exec(block, names)
        yield names


def test_loaded_policy_acts_on_arrays(namespace: dict) -> None:
    assert isinstance(namespace["policy"](np.zeros(4)), np.ndarray)


def test_loop_sends_the_torque_of_the_state_once_a_control_period(
    namespace: dict, robot: Robot
) -> None:
    assert len(robot.torques) == 25
    assert all((torque == namespace["policy"](robot.start)).all() for torque in robot.torques)
    assert robot.times[-1] - robot.times[0] > 23 * 0.02  # the first may come late


def test_environment_executes_the_policy(namespace: dict) -> None:
    rollout = namespace["rollout"]
    assert rollout.batch_size == (20, 25)
    assert torch.equal(rollout["action"], namespace["policy"](rollout["observation"]))


def test_exported_program_gives_the_torque_of_the_policy(namespace: dict) -> None:
    hanging = torch.tensor([torch.pi, 0.0, 0.0, 0.0], dtype=torch.float64)
    torch.testing.assert_close(
        namespace["torque"], load_policy(RUN / "policy.pt")(hanging), rtol=0, atol=1e-12
    )


def test_table_holds_the_benchmarks_numbers_and_no_median_reaches_a_millisecond() -> None:
    rows = json.loads(
        (ROOT / "results" / "benchmarks" / "policy_step" / "summary.json").read_text()
    )["rows"]
    for row in rows:
        numbers = [
            row[name]
            for name in ("cpu_us_min", "cpu_us_median", "wall_us_median", "wall_us_99_percent")
        ]
        assert f"| {row['form']} | {' | '.join(f'{number:.0f}' for number in numbers)} |" in PAGE
        assert row["cpu_us_median"] < 1000 and row["wall_us_median"] < 1000
