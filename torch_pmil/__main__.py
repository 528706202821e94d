"""``python -m torch_pmil`` is the command ``pmil``."""

from torch_pmil.cli import main

main()
