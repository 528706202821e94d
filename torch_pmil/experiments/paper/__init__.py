"""The experiments of the paper, by name. Each is a file with its runs, its numbers and its figures."""

from torch_pmil.experiments.paper.cloning import CLONING
from torch_pmil.experiments.paper.figure6 import FIGURE6
from torch_pmil.experiments.paper.figure7a import FIGURE7A
from torch_pmil.experiments.paper.figure7b import FIGURE7B

PAPER = {experiment.name: experiment for experiment in (FIGURE6, FIGURE7A, FIGURE7B, CLONING)}
