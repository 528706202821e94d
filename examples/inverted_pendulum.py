"""A pole on a cart learns to recover as five recordings show; they hold positions, no forces."""

import gymnasium

from torch_pmil import PMIL

robot = gymnasium.make("InvertedPendulum-v5", reset_noise_scale=0.1, render_mode="rgb_array")
learner = PMIL(
    robot,
    "examples/inverted_pendulum.csv",  # demonstration,time,x,q
    control_period=0.04,  # s
    state=("x", "q", "dx", "dq"),  # what the robot observes; dx is the velocity of x
)
learner.learn(seed=0)  # prints each trial; report, figures and video are in runs/
print(f"success rate {learner.evaluate():.0%} from 20 fresh starts")
learner.save("policy.pt")
