"""The experiments of the paper, by name. Each is a file with its runs, its numbers and its figures."""

from torch_pmil.experiments.paper.ablation import ABLATION
from torch_pmil.experiments.paper.biorob import BIOROB
from torch_pmil.experiments.paper.figure6 import FIGURE6
from torch_pmil.experiments.paper.figure7a import FIGURE7A
from torch_pmil.experiments.paper.figure7b import FIGURE7B
from torch_pmil.experiments.paper.figure9 import FIGURE9
from torch_pmil.experiments.paper.figure11 import FIGURE11
from torch_pmil.experiments.paper.handwriting import HANDWRITING
from torch_pmil.experiments.paper.hidden_motors import HIDDEN_MOTORS
from torch_pmil.experiments.paper.masses import MASSES
from torch_pmil.experiments.paper.reaching import REACHING
from torch_pmil.experiments.paper.robustness import ROBUSTNESS

EXPERIMENTS = (FIGURE6, FIGURE7A, FIGURE7B, MASSES, ROBUSTNESS, ABLATION, FIGURE9, BIOROB, HIDDEN_MOTORS, FIGURE11, REACHING, HANDWRITING)
PAPER = {experiment.name: experiment for experiment in EXPERIMENTS}
