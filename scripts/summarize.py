"""``pmil summarize`` from a clone: put several runs of one experiment together."""

from torch_pmil.cli.summarize import main

main()
