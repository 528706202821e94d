"""``python -m reproduction`` under a shorter name: reproduce an experiment of the paper."""

from reproduction.__main__ import main

main()
