"""Checks of arguments, each of which raises one line: what was expected, what came, where."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Iterable, Sequence
from difflib import get_close_matches
from numbers import Integral, Real

import numpy as np
import torch
from torch import Tensor

from torch_pmil.files import short

WHOLE = 1e-6  # by which a ratio may differ from a whole number
LARGEST = sys.float_info.max  # of whole numbers, which Python lets grow beyond it
LONGEST_NAME = 100  # characters
Shape = tuple[int | str, ...]


def plain(value: object) -> object:
    """A number of NumPy as one of Python, anything else as it is.

    Example:
        >>> plain(np.float32(0.5)), plain("auto")
        (0.5, 'auto')
    """
    return value.item() if isinstance(value, np.generic) else value


def is_whole_number(value: object) -> bool:
    """Whether a value is an integer of Python or NumPy, and not a bool."""
    return isinstance(value, Integral) and not isinstance(value, bool)


def check_whole(name: str, value: object, least: int, most: int | None = None) -> int:
    """A whole number of that range, of Python or NumPy, as an int; ValueError for another value.

    Example:
        >>> check_whole("seed", np.int64(3), 0)
        3
        >>> check_whole("trials", 0, 1)
        Traceback (most recent call last):
        ValueError: trials must be a whole number of at least 1, got 0
    """
    whole = is_whole_number(value)
    if not whole or value < least or (most is not None and value > most):  # type: ignore[operator]
        wanted = f"of at least {least}" if most is None else f"from {least} to {most}"
        raise ValueError(f"{name} must be a whole number {wanted}, got {value!r}")
    return int(value)  # type: ignore[call-overload]


def whole_multiple(value: float, unit: float) -> int | None:
    """How many units a positive value has, if that is a whole number from 1 on; else None.

    Example:
        >>> whole_multiple(0.3, 0.1), whole_multiple(0.25, 0.1)
        (3, None)
    """
    ratio = value / unit
    whole = math.isfinite(ratio) and math.isclose(ratio, round(ratio), rel_tol=WHOLE)
    return round(ratio) if whole and ratio >= 1 - WHOLE else None


def check_positive(name: str, value: object, zero: bool = False) -> float:
    """A finite number above zero, or zero if ``zero`` is True, of Python, NumPy or PyTorch.

    It is returned as a float; ValueError for another value.

    Example:
        >>> check_positive("width", np.float32(0.5))
        0.5
        >>> check_positive("width", float("nan"))
        Traceback (most recent call last):
        ValueError: width must be a positive finite number, got nan
    """
    single = isinstance(value, np.generic | np.ndarray | Tensor) and value.ndim == 0
    number = value.item() if single else value  # type: ignore[attr-defined]
    real = isinstance(number, Real) and not isinstance(number, bool)
    if not real or not 0 <= number <= LARGEST or (number == 0 and not zero):  # type: ignore[operator]
        wanted = "a finite number that is not negative" if zero else "a positive finite number"
        raise ValueError(f"{name} must be {wanted}, got {value!r}")
    return float(number)  # type: ignore[arg-type]


def check_number(name: str, value: object) -> None:
    """Raise ValueError unless a value is a finite real number.

    Example:
        >>> check_number("target of x", None)
        Traceback (most recent call last):
        ValueError: target of x must be a finite number, got None
    """
    number = isinstance(value, Real) and not isinstance(value, bool)
    if not number or not math.isfinite(value):  # type: ignore[arg-type]
        raise ValueError(f"{name} must be a finite number, got {value!r:.80}")


def check_names(name: str, values: object) -> None:
    """Raise unless a value is a sequence of different names of at most 100 printable characters.

    Example:
        >>> check_names("angles", "q1")
        Traceback (most recent call last):
        TypeError: angles must be a sequence of names, such as ('q1',), got the text 'q1'
    """
    if isinstance(values, str) or not isinstance(values, Sequence):
        such = f", such as ({short(values)},), got the text" if isinstance(values, str) else ", got"
        raise TypeError(f"{name} must be a sequence of names{such} {short(values)}")
    for each in values:
        check_text(f"each of {name}", each)
    if len(set(values)) < len(values):
        raise ValueError(f"{name} must be different names, got {short(values)}")


def did_you_mean(name: str, known: Iterable[str], otherwise: str, cutoff: float = 0.6) -> str:
    """The known name that is nearest to an unknown one, as a question; otherwise other words.

    Example:
        >>> did_you_mean("tolerence", ("tolerance", "trials"), "there is no such setting")
        'did you mean tolerance?'
    """
    near = get_close_matches(name, list(known), 1, cutoff)
    return f"did you mean {near[0]}?" if near else otherwise


def check_text(name: str, value: object, empty: bool = False) -> None:
    """Raise ValueError unless a value is one line of text of at most 100 printable characters."""
    fits = isinstance(value, str) and value == value.strip() and value.isprintable()
    if not fits or not (empty or value) or len(value) > LONGEST_NAME:  # type: ignore[arg-type]
        raise ValueError(
            f"{name} must be text of {0 if empty else 1} to {LONGEST_NAME} printable characters, "
            f"without spaces around it, got {short(value)}"
        )


def check_tensor(name: str, values: object, shape: Shape, finite: bool = True) -> None:
    """Raise unless a value is a tensor of real numbers of that shape.

    Args:
        name: of the argument, for the error.
        values: the argument.
        shape: its lengths; a letter is any length of at least one, a leading ``"*batch"`` any
            number of dimensions.
        finite: whether all its entries must be finite.

    Raises:
        TypeError: it is no tensor.
        ValueError: it holds no real numbers, has another shape, or an entry is not finite.

    Example:
        >>> check_tensor("actions", torch.zeros(7, 3), ("*batch", 2))
        Traceback (most recent call last):
        ValueError: actions must have shape (*batch, 2), got (7, 3)
    """
    check_real(name, values)
    assert isinstance(values, Tensor)
    if not _fits(tuple(values.shape), shape):
        wanted = str(shape).replace("'", "")
        raise ValueError(f"{name} must have shape {wanted}, got {tuple(values.shape)}")
    if finite:
        check_finite_entries(name, values)


def check_positive_entries(name: str, values: Tensor) -> None:
    """Raise ValueError unless all entries of a tensor are positive."""
    if not (values > 0).all():
        raise ValueError(f"{name} must be positive, got {values.min().item():.3g}")


def check_real(name: str, values: object) -> None:
    """Raise TypeError unless a value is a tensor, and ValueError unless it holds real numbers."""
    if not isinstance(values, Tensor):
        raise TypeError(f"{name} must be a tensor, got {type(values).__name__}")
    if values.is_complex() or values.dtype == torch.bool:
        raise ValueError(f"{name} must hold real numbers, got {values.dtype}")


def check_noise(noise_std: object, names: Sequence[str], zero: bool = False) -> Tensor:
    """Observation noise as a float64 tensor, () or (M,).

    Args:
        noise_std: one standard deviation, or one for each entry.
        names: of the M entries.
        zero: whether a standard deviation may be zero.

    Raises:
        ValueError: there is neither one number nor one for each entry, or one of them is not finite
            or not positive.
    """
    try:
        if isinstance(noise_std, bool):
            raise TypeError
        noise = torch.as_tensor(noise_std, dtype=torch.float64)
    except (TypeError, ValueError, OverflowError, RuntimeError):
        noise = torch.zeros(0)
    if noise.numel() and not ((noise > 0) | ((noise == 0) & zero)).all():
        wanted = "not be negative" if zero else "be positive"
        raise ValueError(f"noise_std must {wanted}, got {noise.tolist()}")
    if noise.shape not in ((), (len(names),)) or not noise.isfinite().all():
        raise ValueError(
            f"noise_std must be a number or one for each of {', '.join(names)}, got "
            f"{noise.tolist() if noise.numel() else repr(noise_std)}"
        )
    return noise


def check_finite_entries(
    name: str,
    values: Tensor,
    error: Callable[[str, tuple[int, ...]], ValueError] = lambda message, _: ValueError(message),
) -> None:
    """Raise an error for the first entry that is not finite, made of a message and its index."""
    finite = values.isfinite()
    if not finite.all():
        entry = tuple((~finite).nonzero()[0].tolist())
        raise error(f"{name} must be finite, got {values[entry].item()} in entry {entry}", entry)


def _fits(found: tuple[int, ...], shape: Shape) -> bool:
    own = shape[1:] if shape[:1] == ("*batch",) else shape
    if len(found) < len(own) or (len(found) > len(own) and len(own) == len(shape)):
        return False
    lengths = zip(found[len(found) - len(own) :], own, strict=True)
    return all(length > 0 if isinstance(want, str) else length == want for length, want in lengths)
