"""The experiments of the paper, by name. Each is a file with its runs, its numbers and its figures."""

from torch_pmil.experiments.paper.ablation import ABLATION
from torch_pmil.experiments.paper.figure6 import FIGURE6
from torch_pmil.experiments.paper.figure7a import FIGURE7A
from torch_pmil.experiments.paper.figure7b import FIGURE7B
from torch_pmil.experiments.paper.figure9 import FIGURE9
from torch_pmil.experiments.paper.masses import MASSES
from torch_pmil.experiments.paper.robustness import ROBUSTNESS

PAPER = {experiment.name: experiment for experiment in (FIGURE6, FIGURE7A, FIGURE7B, FIGURE9, MASSES, ROBUSTNESS, ABLATION)}
