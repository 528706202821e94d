"""Export a saved policy as a program of PyTorch (.pt2) or of ONNX (.onnx).

Example:
    pmil export runs/double_pendulum/seed_0/policy.pt policy.pt2
    pmil export runs/double_pendulum/seed_0/policy.pt policy.onnx
"""

from __future__ import annotations

from pathlib import Path

from torch_pmil.cli import check_new, errors_in_one_line, parser_of
from torch_pmil.control.policy_file import load_policy


def main() -> None:
    """Read the command line, load, export, print what the program takes and returns."""
    parser = parser_of(__doc__)
    parser.add_argument("policy", type=Path, help="policy.pt of a run")
    parser.add_argument("out", type=Path, help="file to write, ending in .pt2 or .onnx")
    parser.add_argument(
        "--batch", action="store_true", help="take states (N, D), not one state (D,)"
    )
    arguments = parser.parse_args()
    check_new(arguments.out)
    with errors_in_one_line(OSError, ValueError, ModuleNotFoundError):
        policy = load_policy(arguments.policy)
        policy.export(arguments.out, batch=arguments.batch)
    print(f"wrote {arguments.out}: {policy.extra_repr()}")
