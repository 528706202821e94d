"""Compile the prediction for this processor, so that the first training need not.

Example:
    pmil compile
"""

from __future__ import annotations

import time

from torch_pmil.cli import Parser
from torch_pmil.model.compiled import available, kernels


def main() -> None:
    """Compile what is not in the cache, and say how long it took."""
    Parser(description=__doc__.partition("\n")[0]).parse_args()
    if available():
        start = time.process_time()
        folder = kernels().compile_all()
        where = "nowhere, for no folder can be written" if folder is None else folder
        print(
            f"the prediction is compiled ({time.process_time() - start:.1f} CPU s), kept in {where}"
        )
