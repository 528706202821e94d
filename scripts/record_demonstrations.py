"""Let the expert demonstrate a task in simulation and record what an observer sees: positions, no torques.

Example:
    python scripts/record_demonstrations.py experiment=double_pendulum seed=0 out=demonstrations.npz
"""

from __future__ import annotations

import sys
from pathlib import Path

import hydra
import numpy as np
import torch
from omegaconf import DictConfig

import torch_pmil.demonstrations
from torch_pmil.demonstrations import Demonstrations
from torch_pmil.envs.double_pendulum import DoublePendulumEnv, link_positions
from torch_pmil.envs.swing_up import STEPS, array_dynamics, swing_up_expert
from torch_pmil.envs.trajectory_optimization import Array, roll_out
from torch_pmil.experiments.double_pendulum import SUCCESS_DISTANCE, distance_from_upright

DEMONSTRATIONS = 5  # paper


def record_double_pendulum(seed: int, torque_noise: float) -> Demonstrations:
    """Five swing-ups from starts drawn with the seed, all successful.

    Args:
        seed: of the starts and of the expert's noise.
        torque_noise: standard deviation of what the expert adds to its torques, drawn anew at each step, in N·m.

    Raises:
        RuntimeError: a demonstration did not stay upright.
    """
    env = DoublePendulumEnv(num_envs=DEMONSTRATIONS, seed=seed)
    starts = env.reset()["observation"].numpy()
    expert, noise = swing_up_expert(), np.random.default_rng(seed).normal(size=(STEPS, DEMONSTRATIONS, 2))

    def imprecise_expert(step: int, states: Array) -> Array:
        return (expert(step, states) + torque_noise * noise[step]).clip(-expert.action_limit, expert.action_limit)

    states, torques = roll_out(array_dynamics(env), starts, imprecise_expert, STEPS)
    distances = distance_from_upright(torch.from_numpy(states))
    print("demonstration  largest distance from upright in the last 0.5 s (m)  peak torque (N·m)")
    for number, (distance, peak) in enumerate(zip(distances.tolist(), np.abs(torques).max((1, 2)), strict=True)):
        print(f"{number:13d}  {distance:53.4f}  {peak:17.3f}")
    if not (distances < SUCCESS_DISTANCE).all():
        raise RuntimeError(f"a demonstration must stay within {SUCCESS_DISTANCE} m, got {distances.max():.3f} m")
    return Demonstrations(link_positions(torch.from_numpy(states)), env.control_period, ("x1", "y1", "x2", "y2"))


EXPERIMENTS = {"double_pendulum": record_double_pendulum}


@hydra.main(version_base="1.3", config_path="config", config_name="record")
def main(config: DictConfig) -> None:
    """Record the demonstrations of one experiment and save them."""
    if config.experiment not in EXPERIMENTS:
        sys.exit(f"experiment must be one of {sorted(EXPERIMENTS)}, got {config.experiment}")
    shipped = Path(torch_pmil.demonstrations.__file__).parent / "data" / f"{config.experiment}.npz"
    out = Path(config.out or shipped)
    if not out.parent.is_dir():
        sys.exit(f"cannot write {out}: there is no folder {out.parent}")
    try:
        EXPERIMENTS[config.experiment](config.seed, config.torque_noise).save(out)
    except (OSError, RuntimeError) as error:
        sys.exit(f"cannot record {out}: {error}")
    print(f"wrote {out}")


if __name__ == "__main__":
    main()
