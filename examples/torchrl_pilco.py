"""TorchRL's PILCO task, InvertedPendulum-v5, with this package's model, policy and environment.

The recipe is that of TorchRL's ``sota-implementations/pilco``. After 200 steps of random forces it
repeats three steps three times: fit the model, minimise TorchRL's expected cost of an imagined
rollout, and roll out on the robot. It minimises by L-BFGS, where TorchRL takes 100 steps of Adam.
The task is learned if the pole stays up for all 1000 steps (40 s) of every evaluation episode. With
``--compare N``, N gradient steps of the same work are timed with these pieces and with TorchRL's.

Example:
    python -m examples.torchrl_pilco --compare 2
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from importlib.util import find_spec

import tensordict
import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModule
from torchrl.envs import EnvBase, GymEnv, StepCounter, TransformedEnv
from torchrl.envs.model_based import ImaginedEnv as TorchRLImaginedEnv
from torchrl.objectives import ExponentialQuadraticCost
from tqdm import tqdm

from benchmarks.workloads import rbf_controller, world_model
from torch_pmil import Gaussian, NotPositiveDefiniteError, RBFPolicy, predict_trajectory
from torch_pmil.gp.lbfgs import MinimiseResult, minimise
from torch_pmil.torchrl_interop import BeliefPolicy, GPWorldModel, ImaginedEnv
from torch_pmil.torchrl_interop.keys import ACTION_BELIEF, STATE_BELIEF

TASK = "InvertedPendulum-v5"
EPISODE = 1000  # steps, of 0.04 s each
START_VARIANCE = 1e-3  # of every entry of the state, as in TorchRL's script
TRANSITION = ("observation", "action", ("next", "observation"))


def main() -> int:
    """Read the command line, learn, and return 0 if the task was learned, else 1."""
    arguments = parse()
    torch.set_num_threads(1)
    torch.manual_seed(arguments.seed)
    env = TransformedEnv(GymEnv(TASK), StepCounter())
    env.set_seed(arguments.seed)
    policy, data = make_policy(env, arguments.basis), random_steps(env, arguments.random_steps)
    for epoch in range(arguments.epochs):
        model = GPWorldModel(obs_dim=4, action_dim=1)
        fit = model.fit(data)
        if epoch == 0 and arguments.compare:
            compare(model, policy, env, arguments.horizon, arguments.compare)
        search, seconds = improve(model, policy, env, arguments)
        episode = act(env, policy, arguments.rollout_steps)
        print(
            f"epoch {epoch + 1}: fit to {len(data)} transitions in {fit.seconds:.1f} s, cost "
            f"{search.initial_loss:.3f} to {search.loss:.3f} in {search.evaluations} gradient "
            f"steps of {seconds:.2f} CPU s, then up for {len(episode)} of "
            f"{arguments.rollout_steps} steps"
        )
        data = tensordict.cat([data, episode])[-arguments.most_data :]
    lengths = [len(act(env, policy, EPISODE)) for _ in range(arguments.episodes)]
    learned = min(lengths) == EPISODE
    print(f"evaluation: {lengths} of {EPISODE} steps; {'learned' if learned else 'not learned'}")
    return 0 if learned else 1


def parse() -> argparse.Namespace:
    """Parse the command line; exit with one line if it or the installation is not suitable."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument(
        "--seed", type=int, default=0, help="of the robot, the random forces and the policy"
    )
    parser.add_argument(
        "--epochs", type=int, default=3, help="times the model is fitted and the policy improved"
    )
    parser.add_argument(
        "--random-steps", type=int, default=200, help="on the robot, before the first fit"
    )
    parser.add_argument("--iterations", type=int, default=60, help="of L-BFGS in each epoch")
    parser.add_argument("--horizon", type=int, default=40, help="steps of an imagined rollout")
    parser.add_argument("--basis", type=int, default=10, help="basis functions of the policy")
    parser.add_argument(
        "--rollout-steps",
        type=int,
        default=100,
        help="at most, of the policy on the robot in each epoch",
    )
    parser.add_argument(
        "--most-data", type=int, default=350, help="newest transitions that the model is fitted to"
    )
    parser.add_argument("--episodes", type=int, default=10, help="of the evaluation at the end")
    parser.add_argument(
        "--compare",
        type=int,
        default=0,
        metavar="N",
        help="also time N gradient steps of ours and of TorchRL's pieces",
    )
    arguments = parser.parse_args()
    wanted = ["gymnasium", *(["botorch"] if arguments.compare else [])]
    missing = [name for name in wanted if find_spec(name) is None]
    if missing:
        parser.error(
            f"needs {' and '.join(missing)}: pip install 'torch_pmil[gym]', and [benchmark] for "
            "--compare"
        )
    for name, value in vars(arguments).items():
        if value <= 0 and name not in ("seed", "compare"):
            parser.error(f"--{name.replace('_', '-')} must be positive, got {value}")
    return arguments


def make_policy(env: EnvBase, basis: int) -> BeliefPolicy:
    """A random policy, as TorchRL's ``RBFController`` begins.

    Centres have standard deviation 0.5, weights 0.1, and widths are 1.
    """
    policy = RBFPolicy(0.5 * torch.randn(basis, 4), u_max=env.action_spec.high, scale=torch.ones(4))
    torch.nn.init.normal_(policy.weights, std=0.1)
    return BeliefPolicy(policy)


def random_steps(env: EnvBase, steps: int) -> TensorDictBase:
    """Transitions (steps,) under random forces, over as many episodes as that takes."""
    return env.rollout(steps, break_when_any_done=False).select(*TRANSITION).double()


@torch.no_grad()
def act(env: EnvBase, policy: BeliefPolicy, steps: int) -> TensorDictBase:
    """Transitions of one episode of the policy."""
    return env.rollout(steps, policy).select(*TRANSITION).double()


def improve(
    model: GPWorldModel, policy: BeliefPolicy, env: EnvBase, arguments: argparse.Namespace
) -> tuple[MinimiseResult, float]:
    """Minimise the expected cost of imagined rollouts; also return a step's mean CPU seconds."""
    evaluate = imagined_cost(ImaginedEnv(model, env), policy, arguments.horizon)
    start = time.process_time()
    with tqdm(desc="gradient steps", leave=False, disable=not sys.stderr.isatty()) as bar:

        def cost() -> torch.Tensor:
            bar.update()
            return evaluate()

        result = minimise(
            policy.parameters(), cost, arguments.iterations, survives=(NotPositiveDefiniteError,)
        )
    return result, (time.process_time() - start) / result.evaluations


def imagined_cost(
    env: EnvBase, policy: TensorDictModule, horizon: int
) -> Callable[[], torch.Tensor]:
    """TorchRL's expected saturating costs, summed over an imagined rollout from the start."""
    loss = ExponentialQuadraticCost(reduction="none")
    belief = {"mean": torch.zeros(4).double(), "var": START_VARIANCE * torch.eye(4).double()}
    start = TensorDict({"observation": belief}).expand(env.batch_size)
    return lambda: loss(env.rollout(horizon, policy, tensordict=start))["loss_cost"].sum(-1).mean()


def loop_cost(
    model: GPWorldModel, policy: BeliefPolicy, horizon: int
) -> Callable[[], torch.Tensor]:
    """The cost of ``imagined_cost`` by the package's own loop, without an environment."""
    loss = ExponentialQuadraticCost(reduction="sum")
    start = Gaussian(torch.zeros(4).double(), START_VARIANCE * torch.eye(4).double())

    def evaluate() -> torch.Tensor:
        later = predict_trajectory(start, policy.policy, model.dynamics, model.space, horizon - 1)
        mean = torch.cat([start.mean[None], later.mean])
        var = torch.cat([start.cov[None], later.cov])
        return loss(TensorDict({"observation": {"mean": mean, "var": var}}))["loss_cost"]

    return evaluate


def compare(
    model: GPWorldModel, policy: BeliefPolicy, env: EnvBase, horizon: int, steps: int
) -> None:
    """Print the time of a gradient step of ours and of TorchRL's pieces.

    Both are given the same posterior and the same policy.
    """
    torchrl_policy = TensorDictModule(
        rbf_controller(policy.policy), in_keys=STATE_BELIEF, out_keys=ACTION_BELIEF
    )
    torchrl_env = TorchRLImaginedEnv(world_model(model.dynamics), env)
    ours = imagined_cost(ImaginedEnv(model, env), policy, horizon)
    theirs = imagined_cost(torchrl_env, torchrl_policy, horizon)
    ways = {
        "torch_pmil in TorchRL's form": (ours, policy),
        "torch_pmil's own loop": (loop_cost(model, policy, horizon), policy),
        "TorchRL's pieces": (theirs, torchrl_policy),
    }
    print(
        f"a gradient step with n = {len(model.dynamics.train_inputs)} transitions and {horizon} "
        f"steps, least of {steps}:"
    )
    for name, (evaluate, actor) in ways.items():
        seconds = []
        for _ in range(steps):
            start = time.process_time()
            cost = evaluate()
            gradients = torch.autograd.grad(cost, list(actor.parameters()))
            seconds.append(time.process_time() - start)
        size = torch.cat([gradient.flatten() for gradient in gradients]).norm()
        print(
            f"  {name:<28} {min(seconds):7.2f} CPU s, cost {cost:.5f}, |gradient| {size:.4f}",
            flush=True,
        )


if __name__ == "__main__":
    sys.exit(main())
