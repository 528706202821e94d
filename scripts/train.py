"""``pmil train`` from a clone: learn an experiment from its demonstrations."""

from torch_pmil.cli.train import main

main()
