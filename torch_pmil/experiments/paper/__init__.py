"""The experiments of the paper, by name. Each is a file with its runs, its numbers and its figures."""

from torch_pmil.experiments.paper.ablation import ABLATION
from torch_pmil.experiments.paper.cloning import CLONING
from torch_pmil.experiments.paper.figure6 import FIGURE6

PAPER = {experiment.name: experiment for experiment in (FIGURE6, CLONING, ABLATION)}
