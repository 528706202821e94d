"""``python -m reproduction.soak`` under a shorter name: many runs of eight tasks, unattended."""

from reproduction.soak.__main__ import main

if __name__ == "__main__":  # not in a process that measures a run
    main()
