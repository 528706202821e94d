"""Learn the double pendulum with the paper's baseline: movement primitives, an inverse model and a
PD controller (Eq. 29).

Example:
    python -m reproduction.baselines.train_dmp seed=0 out=runs/double_pendulum_dmp/seed_0
"""

from __future__ import annotations

import shlex
import sys
from pathlib import Path

import hydra
import torch
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig

from reproduction.baselines.dmp_run import DMPTrial, run_dmp
from torch_pmil.demonstrations import load_demonstrations
from torch_pmil.experiments import load_experiment
from torch_pmil.experiments.runs.report import write_report
from torch_pmil.plotting import plot_learning_curve, save_figure


@hydra.main(version_base="1.3", config_path=str(Path(__file__).parent), config_name="train_dmp")
def main(config: DictConfig) -> None:
    """Learn, and say what came of it."""
    torch.set_num_threads(1)  # the matrices are small: more threads wait for each other
    out = Path(config.out)
    command = shlex.join(
        ["python", "-m", "reproduction.baselines.train_dmp", *HydraConfig.get().overrides.task]
    )
    try:
        demonstrations = (
            load_demonstrations(config.demonstrations) if config.demonstrations else None
        )
        experiment = load_experiment("double_pendulum", demonstrations)
        summary = run_dmp(
            experiment,
            config.seed,
            config.trials,
            out,
            command,
            config.feedback_period,
            print_trial,
        )
    except KeyboardInterrupt:
        print("\nstopped", file=sys.stderr)
        sys.exit(130)
    except (ValueError, OSError, RuntimeError) as error:
        sys.exit(f"error: {error}")
    draw(summary["trials"], out)
    print(
        f"success rate {summary['saved_success_rate']:.0%} of {summary['saved_n_eval']} fresh "
        f"starts after {summary['experience_s']:.1f} s of experience and "
        f"{summary['wall_seconds']:.0f} s of computing\nsee {out / 'report.html'}, "
        f"{out / 'summary.json'}"
    )


def print_trial(trial: DMPTrial) -> None:
    """One line for each trial."""
    print(
        f"trial {trial.trial:2d}: {trial.experience_s:5.1f} s of experience, own rollout "
        f"{'succeeded' if trial.own_success else 'failed'}, success rate "
        f"{trial.success_rate:4.0%} of {trial.n_eval} starts, off the reference by "
        f"{trial.tracking_error:.2f} rad",
        flush=True,
    )


def draw(trials: list[dict], out: Path) -> None:
    """Learning curve and report of a run."""
    experience, rates, errors = (
        [trial[field] for trial in trials]
        for field in ("experience_s", "success_rate", "tracking_error")
    )
    save_figure(
        plot_learning_curve(experience, rates, errors, "tracking error (rad)"),
        out / "figures" / "learning_curve.png",
    )
    write_report(out)


if __name__ == "__main__":
    main()
