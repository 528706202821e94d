"""Put the policy of a finished run into the package, where ``pmil play`` finds it.

Example:
    pmil train experiment=double_pendulum seed=0
    python scripts/ship_policy.py runs/double_pendulum/seed_0
"""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

from torch_pmil.runs.playing import SHIPPED, load_player


def main() -> None:
    """Copy what is needed to play it, and where it comes from."""
    if len(sys.argv) != 2:
        sys.exit(f"expected one argument, the folder of a run, got {len(sys.argv) - 1}")
    run = Path(sys.argv[1])
    try:
        load_player(run)
    except (ValueError, OSError) as error:
        sys.exit(f"error: {error}")
    for name in ("policy.pt", "summary.json"):
        shutil.copyfile(run / name, SHIPPED / name)
    print(f"wrote {SHIPPED}")


if __name__ == "__main__":
    main()
