"""``python -m reproduction`` under a shorter name: reproduce an experiment of the paper."""

from reproduction.__main__ import main

if __name__ == "__main__":  # not in a process that the experiment starts
    main()
