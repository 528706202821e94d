"""Learn the double pendulum with the paper's baseline of movement primitives (Eq. 29).

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
from torch_pmil.files import in_words
from torch_pmil.plotting import plot_learning_curve, save_figure
from torch_pmil.runs.own_files import own
from torch_pmil.runs.report import write_report
from torch_pmil.tasks.registry import load_experiment


@hydra.main(version_base="1.3", config_path=str(Path(__file__).parent), config_name="train_dmp")
def main(config: DictConfig) -> None:
    """Learn, and print the results."""
    torch.set_num_threads(1)  # the matrices are small: more threads wait for each other
    out = Path(config.out)
    command = shlex.join(
        ["python", "-m", "reproduction.baselines.train_dmp", *HydraConfig.get().overrides.task]
    )
    try:
        demonstrations = None
        if config.demonstrations:
            demonstrations = load_demonstrations(config.demonstrations)
        summary = run_dmp(
            load_experiment("double_pendulum", demonstrations),
            config.seed,
            config.trials,
            out,
            command,
            feedback_period=config.feedback_period,
            on_trial=print_trial,
        )
    except KeyboardInterrupt:
        print("\nstopped", file=sys.stderr)
        sys.exit(130)
    except (ValueError, OSError, RuntimeError) as error:
        sys.exit(f"error: {in_words(error)}")
    draw(summary["trials"], out)
    print(
        f"success rate {summary['saved_success_rate']:.0%} of {summary['saved_n_eval']} fresh "
        f"starts after {summary['experience_s']:.1f} s of experience and "
        f"{summary['wall_seconds']:.0f} s of computing\nsee {out / 'report.html'}, "
        f"{out / 'summary.json'}"
    )


def print_trial(trial: DMPTrial) -> None:
    """Print one line for a trial."""
    print(
        f"trial {trial.trial:2d}: {trial.experience_s:5.1f} s of experience, own rollout "
        f"{'succeeded' if trial.own_success else 'failed'}, success rate "
        f"{trial.success_rate:4.0%} of {trial.n_eval} starts, off the reference by "
        f"{trial.tracking_error:.2f} rad",
        flush=True,
    )


def draw(trials: list[dict], out: Path) -> None:
    """Draw the learning curve of a run and write its report."""
    experience = [trial["experience_s"] for trial in trials]
    rates = [trial["success_rate"] for trial in trials]
    errors = [trial["tracking_error"] for trial in trials]
    figure = plot_learning_curve(experience, rates, errors, "tracking error (rad)")
    (out / "figures").mkdir(exist_ok=True)
    save_figure(figure, own(out, "figures/learning_curve.png"))
    write_report(out)


if __name__ == "__main__":
    main()
