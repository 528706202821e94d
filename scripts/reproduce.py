"""Reproduce an experiment of the paper: its numbers in results/, and its figures beside them."""

from reproduction.__main__ import main

main()
