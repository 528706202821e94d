"""Export a saved policy as a program that needs PyTorch alone.

Example:
    pmil export runs/double_pendulum/seed_0/policy.pt policy.pt2
"""

from __future__ import annotations

import sys
from pathlib import Path

from torch_pmil.cli import Parser
from torch_pmil.control.policy_file import load_policy
from torch_pmil.files import in_words


def main() -> None:
    """Read the command line, load, export, say what the program takes and gives."""
    parser = Parser(description=__doc__.partition("\n")[0])
    parser.add_argument("policy", type=Path, help="policy.pt of a run")
    parser.add_argument("out", type=Path, help="file to write, ending in .pt2")
    parser.add_argument(
        "--batch", action="store_true", help="take states (N, D) and not one state (D,)"
    )
    arguments = parser.parse_args()
    try:
        policy = load_policy(arguments.policy)
        policy.export(arguments.out, batch=arguments.batch)
    except (OSError, ValueError) as error:
        sys.exit(f"error: {in_words(error)}")
    print(f"wrote {arguments.out}: {policy.extra_repr()}")
