"""Compile the prediction for this processor, so that the first training need not.

Example:
    pmil compile
"""

from __future__ import annotations

import sys
import time

from torch_pmil.cli import Parser
from torch_pmil.model.compiled import available, kernels


def main() -> None:
    """Compile what is not in the cache, and say how long it took."""
    Parser(description=__doc__.partition("\n")[0]).parse_args()
    if not available():  # which warns
        sys.exit("error: the prediction cannot be compiled, see the warning above")
    start = time.process_time()
    folder = kernels().compile_all()
    spent = f"{time.process_time() - start:.1f} CPU s"
    where = "but not kept: no folder can be written to" if folder is None else f"kept in {folder}"
    print(f"the prediction is compiled ({spent}), {where}")
