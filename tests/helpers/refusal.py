"""What a file that is not as it must be comes to."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from torch_pmil.demonstrations import DemonstrationError


def refused(function: Callable[..., object], *arguments: object, **options: object) -> str:
    """The one line that a function raises."""
    with pytest.raises(DemonstrationError) as error:
        function(*arguments, **options)
    assert "\n" not in str(error.value)
    return str(error.value)
